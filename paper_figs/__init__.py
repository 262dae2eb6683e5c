"""Draw the paper's figures from result folders: `jax-aero figures NAME`. Only reads files, never simulates."""
