"""The study `ahead`."""
