"""Rewards of whole unseen episodes over the time of training, by gradients and by PPO."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry


def draw(*studies: xr.Dataset) -> Figure:
    """Draw the courses of the seeds on the left, with their range, and on the right final rewards over wind speed."""
    figure = style.figure(2.9)
    course, final = figure.subplots(1, 2)
    for study, colour, label in zip(studies, style.GROUP_COLOURS, ("gradients", "PPO"), strict=False):
        minutes = study["minutes"].mean("seed")
        reward, seeds = study["reward"], study.sizes["seed"]
        course.fill_between(minutes, reward.min("seed"), reward.max("seed"), color=colour, alpha=0.25, linewidth=0)
        of = f"{seeds} seed{'s' * (seeds > 1)} of {float(minutes[-1]):.1f} min"
        course.plot(minutes, reward.mean("seed"), color=colour, label=f"{label}, {of}")
        speed = np.linalg.norm(study["wind"], axis=1)
        final.plot(speed, study["final_reward"].T, ".", markersize=3, color=colour)
    course.set_xlabel("processor time [min]")
    course.legend()
    final.set_xlabel("wind [m/s], after training")
    for axes in (course, final):
        axes.set_ylabel("mean reward of an unseen episode")
        axes.set_ylim(0.0, 1.0)
    style.letters((course, final))
    return figure


FIGURES = {
    "policy": Entry(
        draw, "hovering learnt from nothing: rewards over time, and by wind", "policy", ("hover", "hover_ppo")
    ),
}
"""The study `policy`."""
