"""The study `policy`."""
