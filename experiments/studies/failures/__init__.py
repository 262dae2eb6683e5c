"""The study `tip_over`."""
