"""Filters whose belief is one Gaussian."""
