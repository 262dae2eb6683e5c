"""A robot's numbers from its own logs."""
