"""The study `learnt_air`."""
