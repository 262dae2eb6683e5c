"""The study `identify_engine`."""
