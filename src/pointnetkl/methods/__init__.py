"""Every method that answers with a covariance of a registration."""
