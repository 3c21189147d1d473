"""Commands, each in a file of its own: its ``app`` is a part of the command line."""
