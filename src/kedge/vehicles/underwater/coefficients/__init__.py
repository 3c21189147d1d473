"""Sets of hydrodynamic coefficients, one TOML file each."""
