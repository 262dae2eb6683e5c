"""The study `tunnel_mk3`."""
