"""The study `drives`."""
