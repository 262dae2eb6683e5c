"""Errors of what is learnt over minutes of flight, beside the nominal model, its refit and the true air."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

DASHES = {"learnt": "-", "learnt on nominal": "--", "refit": ":"}
"""Lines of the models; colours are kinds of flights."""
LABELS = {
    "moment": "error of the moment, rms [N m]",
    "rotation": "greatest rotation error in\nturbulence, median [degrees]",
}


def draw(study: xr.Dataset) -> Figure:
    """Draw errors of the moment on the left, and rotation errors of flights with the models on the right."""
    figure = style.figure(3.2)
    panels = figure.subplots(1, 2)
    for axes, (measure, label) in zip(panels, LABELS.items(), strict=True):
        for kind, colour in zip(study["kind"].values, style.GROUP_COLOURS, strict=False):
            for model, dash in DASHES.items():
                error = study[measure].sel(kind=kind, model=model)
                axes.plot(study["minutes"], error, dash, color=colour, marker=".", label=f"{kind}: {model}")
        for line in ("nominal", "true"):
            level = float(study[f"{measure}_line"].sel(line=line))
            axes.axhline(level, color=style.BLACK, linewidth=0.8)
            beside = {"xytext": (3, 0), "textcoords": "offset points", "va": "center", "fontsize": 7}
            axes.annotate(line, (1.0, level), xycoords=axes.get_yaxis_transform(), **beside)
        axes.set_xscale("log", base=2)
        axes.set_xticks(study["minutes"].values, [f"{minutes:g}" for minutes in study["minutes"].values])
        axes.set_xlabel("minutes of flight")
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    style.letters(panels)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=7)
    return figure


FIGURES = {"learnt_air": Entry(draw, "errors of the learnt air over minutes of flight", "learnt_air", ("minutes",))}
"""The study `learnt_air`."""
