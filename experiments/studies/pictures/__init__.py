"""The study `pictures`."""
