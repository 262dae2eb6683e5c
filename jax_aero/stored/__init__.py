"""Results that are stored in `docs/results/`: one file writes them, one reads them, one compares them with today's."""
