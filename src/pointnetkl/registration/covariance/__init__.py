"""Covariances: Gaussians, tables of labels and of estimates, and the catalogue of methods."""
