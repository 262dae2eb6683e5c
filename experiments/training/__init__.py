"""Training runs: a file of `configs/training/`, a dataset, and the errors on held-out rows."""
