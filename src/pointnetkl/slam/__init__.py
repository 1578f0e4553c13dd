"""Pose graphs of submaps: their construction (Algorithm 1), the benchmark of Table IV, and what it rests on."""
