"""Pose graphs, trajectories and clouds as other programs write them: g2o, TUM, PCD, PLY."""
