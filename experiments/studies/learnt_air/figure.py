"""Errors of a learnt wrench over minutes of flight, beside what stands without learning."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

LOOKS = {
    "learnt on none": ("learnt from nothing", "-"),
    "learnt on corrected": ("learnt on the nominal model", "--"),
    "refit of corrected": ("coefficients refitted", ":"),
}
"""Word and line of each model."""
KINDS = {"mission": style.BLUE, "hover": style.VERMILION, "excited": style.GREEN}
"""Colours of kinds of flights."""


def draw(study: xr.Dataset) -> Figure:
    """Draw force and moment, each over minutes on a logarithmic axis; the true air leaves zero."""
    figure = style.figure(3.4)
    panels = figure.subplots(1, 2)
    kind, model = study["kind"].values.astype(str), study["model"].values.astype(str)
    for axes, name, unit in zip(panels, ("force", "moment"), ("N", "N m"), strict=True):
        values, minutes = study[name].values, study["minutes"].values
        for of, colour in KINDS.items():
            for key, (words, line) in LOOKS.items():
                rows = (kind == of) & (model == key)
                if rows.any():
                    axes.plot(minutes[rows], values[rows], line, color=colour, marker=".", label=f"{of}: {words}")
        nominal = values[model == "nominal"][0]
        axes.axhline(nominal, color=style.BLACK, linewidth=0.8)
        axes.annotate("nominal model", (minutes.max(), nominal), fontsize=7, ha="right", va="bottom")
        axes.set_xscale("log", base=2)
        ticks = np.unique(minutes[minutes > 0.0])
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_ylim(0.0, 1.15 * max(nominal, np.nanmax(values[model != "nothing"])))
        axes.set_xlabel("minutes of flight")
        axes.set_ylabel(f"error of the {name}, rms [{unit}]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=7)
    return figure


FIGURES = {"learnt_air": Entry(draw, "how much flight it takes to learn the air", "learnt_air", ("minutes",))}
