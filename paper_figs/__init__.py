"""Figures of the paper, a file for each, found by `jax-aero figures`. They read files and never simulate."""
