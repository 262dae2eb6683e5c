"""All results on one page: `jax-aero report` writes `results/report.md` and `results/report.html`.

```text
runs, sweeps ──► metrics ──► claims ──► page ──► Markdown, HTML
```
"""
