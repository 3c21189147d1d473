"""The live service: vehicles that report as they drive, what is believed of them, and a page."""
