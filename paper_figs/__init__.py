"""Draw the paper's figures from result folders: `python -m paper_figs NAME`. Only reads files, never simulates."""
