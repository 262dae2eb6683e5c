"""Rewards of whole unseen episodes over the time of training, by gradients and by PPO."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry


def draw(*studies: xr.Dataset) -> Figure:
    """Draw the courses of the seeds on the left, and on the right final rewards over wind speed."""
    figure = style.figure(2.9)
    course, final = figure.subplots(1, 2)
    for study, colour, label in zip(studies, style.GROUP_COLOURS, ("gradients", "PPO"), strict=False):
        for minutes, reward in zip(study["minutes"], study["reward"], strict=True):
            course.plot(minutes, reward, ".-", color=colour, linewidth=0.8, markersize=4)
        speed = np.linalg.norm(study["wind"], axis=1)
        final.plot(speed, study["final_reward"].T, ".", markersize=3, color=colour)
        seeds = study.sizes["seed"]
        last = float(study["minutes"].isel(judgement=-1).median())
        course.lines[-1].set_label(f"{label}, {seeds} seed{'s' * (seeds > 1)} of {last:.2g} min")
    course.set_xlabel("processor time [min]")
    if len(studies) == 1:
        course.set_xlim(left=0.0)
    else:
        course.set_xscale("log")  # PPO takes many times as long
        style.legend_above(course, columns=len(studies))
    final.set_xlabel("wind [m/s], after training")
    for axes in (course, final):
        axes.set_ylabel("mean reward of an unseen episode")
        axes.set_ylim(0.0, 1.02)
    style.letters((course, final))
    return figure


FIGURES = {
    "policy": Entry(draw, "hovering learnt from nothing: rewards over time, and by wind", "policy", ("hover",)),
}
"""The study `policy`."""
