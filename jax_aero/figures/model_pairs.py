"""Every model in the simulator against every model in the controller: winds flown in balance, and rotation error."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from jax_aero.base.result import UPRIGHT
from jax_aero.figures import style
from jax_aero.figures.sweeps import require
from jax_aero.sweep.intervals import quantiles
from jax_aero.sweep.result import SweepResult

BALANCED = 45.0
"""Greatest rotation error of a completed flight that counts as balanced [deg]."""


def draw(sweep: SweepResult) -> Figure:
    """Draw a matrix for each lever arm: share of winds flown in balance, and the median rotation error."""
    levels = {axis["name"]: axis["levels"] for axis in sweep.document["axes"]}
    suits = {"model", "world"} < levels.keys() and len(levels.get("arms", ())) == 2
    require(sweep, suits, "axes `arms`, of two levels, `model` and `world`")
    flights = sweep.flights
    figure = style.figure(3.6)
    pair = figure.subplots(1, 2, sharey=True)
    for axes, arms, mark in zip(pair, levels["arms"], "ab", strict=True):
        share, lean = matrices(flights[flights["arms"] == arms], levels["model"], levels["world"])
        axes.imshow(share, vmin=0.0, vmax=1.0, cmap="RdYlBu", aspect="auto")
        for row, column in np.ndindex(*share.shape):
            median = "lost" if np.isinf(lean[row, column]) else f"{lean[row, column]:.0f}°"
            text = f"{100 * share[row, column]:.0f}\n{median}"
            is_dark = not 0.2 < share[row, column] < 0.8
            axes.text(column, row, text, ha="center", va="center", fontsize=5.5, color="white" if is_dark else "black")
        axes.grid(visible=False)
        axes.set_xticks(range(len(levels["world"])), levels["world"], rotation=35, ha="right")
        axes.set_yticks(range(len(levels["model"])), levels["model"])
        axes.set_xlabel("simulator")
        axes.set_title(arms)
        style.letter(axes, mark)
    pair[0].set_ylabel("controller")
    figure.supxlabel(
        f"% of winds flown within {BALANCED:.0f}°, and the median of the largest rotation error", fontsize=7
    )
    return figure


def matrices(flights: pd.DataFrame, models: list[str], worlds: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return share of balanced flights and median rotation error [deg], by controller's and simulator's model.

    The error of a lost flight is infinite.
    """
    share, lean = np.zeros((len(models), len(worlds))), np.zeros((len(models), len(worlds)))
    for row, model in enumerate(models):
        for column, world in enumerate(worlds):
            own = flights[(flights["model"] == model) & (flights["world"] == world)]
            error = own["max_rotation_error_deg"].to_numpy()
            share[row, column] = np.mean((own["outcome"] == "completed") & (error <= BALANCED))
            (lean[row, column],) = quantiles(np.where(own["outcome"].isin(UPRIGHT), error, np.inf), [0.5])
    return share, lean
