"""The report on SLAM."""
