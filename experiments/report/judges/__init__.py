"""Judgements of claims: by committed files, results, the tunnel's tables, and sweeps that state their own."""
