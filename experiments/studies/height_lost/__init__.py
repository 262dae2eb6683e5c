"""The study `height_lost`."""
