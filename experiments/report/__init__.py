"""All results on one page: `jax-aero report` writes `results/report.md` and `results/report.html`.

```text
runs, sweeps, studies ──► measures ──► judge, with the bounds of paper.toml ──► templates ──► Markdown ──► HTML
```
"""
