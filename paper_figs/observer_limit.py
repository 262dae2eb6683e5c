"""The greatest moment per angle that the robot holds, against the gain of the observer: predicted and flown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.studies import load

RUNS = ("hover",)
COLOURS = {"roll": style.VERMILION, "yaw": style.BLUE}


def draw(results: Path, names: Sequence[str] = RUNS) -> tuple[Figure, dict[str, str]]:
    """Draw a line for the linearised loop and dots for flights, by axis."""
    study = load(results, "observer_limit", names[0])
    figure, axes = plt.subplots(figsize=(0.6 * style.FULL_WIDTH, 2.8), layout="constrained")
    for axis in study["axis"].values:
        colour = COLOURS[str(axis)]
        of_axis = study.sel(axis=axis)
        axes.plot(study["gain"], of_axis["predicted"], color=colour, label=f"{axis}, linearised loop")
        axes.plot(study["gain"], of_axis["flown"], "o", color=colour, markersize=4, label=f"{axis}, flown")
    axes.set_yscale("log")
    axes.set_xlabel("gain of the observer [1/s]")
    axes.set_ylabel("greatest dM/dθ [N m/rad]")
    axes.legend()
    return figure, {names[0]: str(study.attrs["config_hash"])}
