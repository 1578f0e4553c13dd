"""Training of the networks: the loop, what it reads, its loss and its checkpoints."""
