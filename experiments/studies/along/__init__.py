"""The study `along`."""
