"""Pose graphs, trajectories and submaps in the files of other programs: g2o, TUM and PCD."""
