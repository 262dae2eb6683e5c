"""The study `arm_engines`."""
