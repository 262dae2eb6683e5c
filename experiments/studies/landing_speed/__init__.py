"""The study `landing_speed`."""
