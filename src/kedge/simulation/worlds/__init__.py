"""Worlds: what is simulated, one a file."""
