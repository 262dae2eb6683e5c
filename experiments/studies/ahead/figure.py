"""Three controllers in turbulence and after an engine stops."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from experiments.studies.ahead.study import STOP
from paper_figs import style
from paper_figs.entry import Entry

LOOKS = {"aware": (style.ORANGE, ":"), "observer": (style.BLUE, "--"), "predictive": (style.GREEN, "-")}


def draw(turbulence: xr.Dataset, engine: xr.Dataset) -> Figure:
    """Draw rotation errors in turbulence and after the loss, and the height after the loss."""
    figure = style.figure(2.9)
    panels = figure.subplots(1, 3)
    after = engine.sel(time=slice(STOP - 2.0, STOP + 12.0))
    shown = ((turbulence, "rotation"), (after, "rotation"), (after, "height"))
    for axes, (study, signal) in zip(panels, shown, strict=True):
        for name, (colour, dashes) in LOOKS.items():
            line = study[signal].sel(controller=name).dropna("time")
            axes.plot(line["time"], line, color=colour, linestyle=dashes, label=name, linewidth=1.0)
            if float(line["time"][-1]) < float(study["time"][-1]):
                axes.plot(line["time"][-1], line[-1], "X", color=colour, markersize=6)
        axes.set_xlabel("time [s]")
    for axes, text in zip(
        panels,
        ("rotation error, 18 m/s turbulent [deg]", "rotation error, engine lost [deg]", "height, engine lost [m]"),
        strict=True,
    ):
        axes.set_ylabel(text)
    for axes in panels[:2]:
        axes.set_yscale("log")
        axes.set_ylim(0.02, 200.0)
    panels[0].legend()
    style.letters(panels)
    return figure


FIGURES = {
    "ahead": Entry(
        draw, "three controllers in turbulence and after an engine stops", "ahead", ("turbulence", "engine")
    ),
}
