"""Facts of a raw file, as text and as JSON, and plots of it: what command `inspect` shows."""
