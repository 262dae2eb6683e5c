"""The study `identify_aero`."""
