"""The study `force_rate`."""
