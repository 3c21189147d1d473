"""Layer 1: mathematics without opinions."""
