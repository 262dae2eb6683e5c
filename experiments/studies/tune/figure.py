"""Course of a tuning by gradient: costs of the worlds of each step and of the validation, and the factors."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry


def draw(study: xr.Dataset) -> Figure:
    """Draw costs on the left, factors on the right."""
    figure = style.figure(2.9)
    costs, factors = figure.subplots(1, 2)
    costs.plot(study["step"], study["cost"], color=style.BLUE, alpha=0.5, linewidth=0.8, label="worlds of the step")
    costs.plot(study["validation"], study["unseen_cost"], "o-", color=style.BLACK, markersize=3, label="unseen worlds")
    costs.set_ylabel("cost, geometric mean")
    costs.legend()
    for key in study["key"].values:
        factors.plot(study["validation"], study["factor"].sel(key=key), label=str(key))
    factors.set_ylabel("factor on the original value")
    factors.legend(fontsize=5, ncols=2)
    for axes in (costs, factors):
        axes.set_yscale("log")
        axes.set_xlabel("step")
    style.letters((costs, factors))
    return figure


FIGURES = {
    "tune": Entry(draw, "gains and weights tuned by gradient: costs and factors", "tune", ("aero_aware",)),
}
