"""The study `margins`."""
