"""The study `trim`."""
