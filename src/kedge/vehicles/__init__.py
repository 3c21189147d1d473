"""Layer 2: one vehicle a file; a file dropped in here is found without being named."""
