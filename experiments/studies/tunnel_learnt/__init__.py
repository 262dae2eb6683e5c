"""The study `tunnel_learnt`."""
