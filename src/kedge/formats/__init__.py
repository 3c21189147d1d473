"""Formats at the edge: units, frames and time bases are converted here and nowhere else."""
