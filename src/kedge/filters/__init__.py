"""Layer 2: one filter a file; a file dropped in here is found without being named."""
