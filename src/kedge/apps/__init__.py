"""Layer 6: what people run. No mathematics in here."""
