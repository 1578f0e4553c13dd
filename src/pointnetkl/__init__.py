"""PointNetKL: covariances of GICP registration for bathymetric SLAM, and the benchmark that judges them."""

__version__ = "0.1.0"
