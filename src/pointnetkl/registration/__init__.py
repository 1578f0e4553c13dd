"""Registration of submaps by GICP, and its covariance by Monte Carlo."""
