"""The flow around the robot by the open solver: pressure on the surface, and three fields in the plane of symmetry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from paper_figs import style
from paper_figs.studies import load

RUNS = ("flight30",)
VIEW = 0.9
"""Half the height of the pictures of the plane [m]."""
FACE_POINTS = 2.4
"""Edge of the mark of a face [points]: faces of a centimetre on a picture of the robot."""


def draw(results: Path, names: Sequence[str] = RUNS) -> tuple[Figure, dict[str, str]]:
    """Draw one case, the wind from the left."""
    study = load(results, "cfd_flow", names[0])
    turn = _upright(study.attrs["wind"])
    figure, grid = plt.subplots(2, 2, figsize=(style.FULL_WIDTH, 6.0), layout="constrained")
    _wall(figure, grid[0, 0], study, turn)
    speed = np.linalg.norm(study["plane_velocity"].values, axis=1)
    _plane(
        figure, grid[0, 1], study, turn, study["plane_pressure"].values, "pressure coefficient", (-1.0, 1.0, "RdBu_r")
    )
    _plane(figure, grid[1, 0], study, turn, speed, "speed over the wind's", (0.0, 1.3, "viridis"))
    viscosity = study["plane_viscosity"].values
    _plane(figure, grid[1, 1], study, turn, viscosity, r"$\nu_t/\nu$", (0.0, float(viscosity.max()), "magma"))
    for axes, mark in zip(grid.flat, "abcd", strict=True):
        style.letter(axes, mark)
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.set_xlabel("along the wind [m]")
    return figure, {names[0]: str(study.attrs["config_hash"])}


def _upright(wind: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation (2, 2) that turns the plane of symmetry, (x, z) of the base, such that the wind blows to the right."""
    along = np.array([wind[0], wind[2]]) / np.hypot(wind[0], wind[2])
    return np.array([along, [-along[1], along[0]]])


def _wall(figure: Figure, axes: Axes, study: xr.Dataset, turn: NDArray[np.float64]) -> None:
    """Pressure on the faces of the surface, seen from the robot's left, the near ones over the far ones."""
    position = study["wall_position"].values
    order = np.argsort(-position[:, 1])
    flat = position[order][:, [0, 2]] @ turn.T
    pressure = study["wall_pressure"].values[order]
    x, y = flat.T
    shown = axes.scatter(x, y, c=pressure, s=FACE_POINTS**2, marker="s", cmap="RdBu_r", vmin=-1.0, vmax=1.0, lw=0)
    shown.set_rasterized(True)
    figure.colorbar(shown, ax=axes, label="pressure coefficient", shrink=0.8)
    axes.set_title("on the surface")


def _plane(
    figure: Figure,
    axes: Axes,
    study: xr.Dataset,
    turn: NDArray[np.float64],
    values: NDArray[np.float64],
    label: str,
    scale: tuple[float, float, str],
) -> None:
    """One field in the plane of symmetry, the robot's parts in it over it."""
    flat = study["plane_position"].values[:, [0, 2]] @ turn.T
    low, high, colours = scale
    levels = np.linspace(low, high, 41)
    shown = axes.tricontourf(Triangulation(flat[:, 0], flat[:, 1]), values, levels, cmap=colours, extend="both")
    cut = study["triangles"].values[:, :, [0, 2]] @ turn.T
    axes.add_collection(PolyCollection(list(cut), facecolor=style.GREY, edgecolor=style.GREY, linewidth=0.5))
    axes.set_xlim(-0.8 * VIEW, 1.2 * VIEW)
    axes.set_ylim(-VIEW, VIEW)
    figure.colorbar(shown, ax=axes, label=label, shrink=0.8)
