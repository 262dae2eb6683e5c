"""All results on one page: `jax-aero report` writes `results/report.md` and `results/report.html`.

```text
runs, sweeps ──► metrics ──► judges, the table of the paper ──► page ──► Markdown, HTML
```
"""
