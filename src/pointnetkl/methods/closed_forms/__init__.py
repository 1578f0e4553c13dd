"""Covariances from one submap and a formula; nothing is learned."""
