"""Covariances by a few numbers that were fitted to training labels."""
