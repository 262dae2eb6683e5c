"""The study `landing_map`."""
