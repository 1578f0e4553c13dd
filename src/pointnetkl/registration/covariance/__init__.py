"""Covariances as numbers: Gaussians, tables of labels and of estimates."""
