"""Ways to get Q, the covariance of a registration: one module each, behind the interface of `method`."""
