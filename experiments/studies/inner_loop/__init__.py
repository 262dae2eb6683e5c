"""The study `inner_loop`."""
