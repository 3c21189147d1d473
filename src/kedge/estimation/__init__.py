"""Layer 3: where vehicle, sensors and filter meet."""
