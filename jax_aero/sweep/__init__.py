"""Many flights from one file: `jax-aero sweep NAME`.

```text
spec (TOML) ──► cells (design) ──► rows: cells x repeats, perturbed ──► chunks ──► table.parquet, cells.parquet
```

A row is determined by its number alone, so any process can fly any chunk, in any order, with the same result.
"""
