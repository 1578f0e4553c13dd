"""Pose graphs and the search for their optimum."""
