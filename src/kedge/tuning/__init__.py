"""Numbers of a rig found from a recorded log."""
