"""Readers of recorded data sets, one a file, and how the sets get onto this machine."""
