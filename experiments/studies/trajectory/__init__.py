"""The study `trajectory`."""
