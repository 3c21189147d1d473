"""Chaotic systems on which the data assimilation literature compares filters."""
