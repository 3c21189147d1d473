"""Rig and scenario files: what they say, inheritance, and the models built from them."""
