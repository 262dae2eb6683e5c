"""Draw the paper's figures from result folders: `python -m paper_figs NAME`. Reads files, never simulates."""
