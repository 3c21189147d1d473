"""Figures of merit: how good an estimate is, and whether it knows."""
