"""Layer 4: worlds in which the truth is known."""
