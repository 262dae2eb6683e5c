"""The study `tune`."""
