"""The SLAM benchmark: pose graphs, loop closures, errors."""
