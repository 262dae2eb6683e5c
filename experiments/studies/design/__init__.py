"""The study `design`."""
