"""Surveys and submaps: their tables, poses and voxels."""
