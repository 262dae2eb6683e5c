"""Loss curves of all networks of a training run, on training rows and on held-out rows."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style

KINDS = (
    ("grouped", "whole postures held out", style.BLUE),
    ("random", "random rows held out", style.ORANGE),
    ("final", "all rows", style.BLACK),
)


def draw(study: xr.Dataset) -> Figure:
    """Draw members on the left, and students, if any, on the right."""
    curves = [str(name) for name in study["curve"].values]
    panels = [("member", "networks trained on data")]
    if any("student" in name for name in curves):
        panels.append(("student", "students of their mean"))
    figure = style.figure(2.7)
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)
    for axes, (word, title) in zip(grid[0], panels, strict=True):
        seen: set[str] = set()
        for name in curves:
            if word not in name:
                continue
            kind, text, colour = next(entry for entry in KINDS if name.startswith(entry[0]))
            curve = study.sel(curve=name)
            for variable, dashes, alpha, suffix in (
                ("train_loss", ":", 0.5, "while training"),
                ("validation_loss", "-", 0.8, "held out"),
            ):
                values = np.asarray(curve[variable])
                if not np.isfinite(values).any():
                    continue
                label = f"{text}: {suffix}" if f"{kind}{suffix}" not in seen else None
                seen.add(f"{kind}{suffix}")
                axes.plot(curve["epoch"], values, dashes, color=colour, alpha=alpha, linewidth=0.9, label=label)
        axes.set_yscale("log")
        axes.set_xlabel("epoch")
        axes.set_title(title)
    grid[0, 0].set_ylabel("mean squared error [m$^4$]")
    grid[0, 0].legend(fontsize=6)
    style.letters(grid[0])
    return figure
