"""The study `tunnel_moments`."""
