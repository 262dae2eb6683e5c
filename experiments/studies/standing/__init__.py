"""The study `standing`."""
