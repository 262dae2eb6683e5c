"""The study `observer_limit`."""
