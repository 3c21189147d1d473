"""Where something is, from one epoch of ranges: no memory, no motion model."""
