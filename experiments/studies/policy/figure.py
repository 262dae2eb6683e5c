"""Course of the training of a policy, and rewards in winds that training did not use."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from jax_aero.base.controllers import CONTROLLERS
from jax_aero.figures import style
from jax_aero.figures.entry import Entry

WINDOW = 20
"""Steps over which the course is averaged."""
NAMES = {
    "test1": CONTROLLERS["baseline"].label,
    "test1_observer": CONTROLLERS["observer_without_model"].label,
    "test2": CONTROLLERS["aero_aware"].label,
}
"""Labels of the experiments."""


def draw(study: xr.Dataset) -> Figure:
    """Draw the course on the left, and rewards over wind speed on the right."""
    figure = style.figure(2.9)
    course, unseen = figure.subplots(1, 2)
    smooth = study["reward"].rolling(step=WINDOW, min_periods=1).mean()
    ticks = study.attrs["ticks_per_step"] * (study["step"] + 1) / 1e3
    course.fill_between(ticks, smooth.min("seed"), smooth.max("seed"), color=style.BLUE, alpha=0.25, linewidth=0)
    course.plot(ticks, smooth.mean("seed"), color=style.BLUE, label="mean and range of the seeds")
    course.set_xlabel("ticks of training, thousands per seed")
    speed = np.linalg.norm(study["wind"], axis=1)
    order = np.argsort(speed)
    for name, colour in zip(map(str, study["flown"].values), style.GROUP_COLOURS, strict=False):
        rewards = study["unseen_reward"].sel(flown=name).values
        unseen.plot(speed[order], rewards[order], ".", markersize=3, color=colour, label=NAMES.get(name, name))
    unseen.set_xlabel("wind [m/s]")
    course.set_title("training, in winds drawn anew for every step")
    unseen.set_title("afterwards, in unseen winds")
    for axes in (course, unseen):
        axes.set_ylabel("mean reward")
        axes.legend()
    style.letters((course, unseen))
    return figure


FIGURES = {
    "policy": Entry(draw, "a residual learnt by gradients: course and rewards in unseen winds", "policy", ("hover",)),
}
