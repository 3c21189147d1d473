"""The torpedo-shaped underwater vehicle: hydrodynamics, hull geometry, coefficients."""
