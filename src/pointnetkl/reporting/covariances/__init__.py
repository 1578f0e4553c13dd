"""The report on the methods' covariances."""
