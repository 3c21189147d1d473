"""Layer 2: one sensor a file; a file dropped in here is found without being named."""
