"""The study `failures`."""
