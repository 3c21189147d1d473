"""The live service: vehicles that report as they drive, and what is believed of them."""
