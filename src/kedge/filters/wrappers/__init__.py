"""Filters around other filters: gates, robust losses, adaptive noise, several models."""
