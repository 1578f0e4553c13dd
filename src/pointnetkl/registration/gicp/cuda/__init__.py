"""Registration of noisy copies on an NVIDIA GPU; it has run on a simulated one only, so it is experimental."""
