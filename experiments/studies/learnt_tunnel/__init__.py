"""The study `learnt_tunnel`."""
