"""Registration of noisy copies on an NVIDIA GPU. Experimental: it has run on a simulated GPU only."""
