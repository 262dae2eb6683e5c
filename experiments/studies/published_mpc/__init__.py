"""The study `published_mpc`."""
