"""PointNetKL: covariances of GICP registration for bathymetric SLAM, and the benchmark that judges them."""

__version__ = "0.2.0"
