"""Fig. 6: the ground experiments, a to f in a frontal and g to l in a lateral measured wind; the true wind is zero.

a, g  wind    b, h  total aerodynamic force assumed by the controller    c, i  CoM, from its place before the wind
d, j  joints of the left leg    e, k  their commanded torques    f, l  torques on the joints
Pale lines: the real robot's record (`configs/records`). It has no CoM of the lateral run: that is our model's, with the
recorded joints.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from jax_aero.base import flights, places
from jax_aero.base.quantities import shown
from jax_aero.figures import panels, style
from jax_aero.figures.entry import Entry

RECORDS = {"balancing_front": "standing_front_2", "balancing_lateral": "standing_lateral"}
"""The record of the run of a name, and of one that begins with it."""
PALE: dict[str, Any] = {"alpha": 0.4, "linewidth": 1.8}

CALM = (4.0, 9.0)
"""Time before the wind [s]."""

LEG = (
    ("hip_pitch", style.VERMILION, "-"),
    ("hip_roll", style.GREEN, "-"),
    ("hip_yaw", style.PURPLE, "-"),
    ("knee", style.BLACK, "--"),
    ("ankle_pitch", style.ORANGE, "-"),
    ("ankle_roll", style.BLUE, "-"),
)
"""Joints of a leg, with colours and dashes."""


def draw(*runs: xr.Dataset) -> Figure:
    """Draw the figure from two runs: the first in panels a to f, the second in g to l."""
    figure = style.figure(8.6)
    parts = figure.subfigures(2, 1, squeeze=False)[:, 0]
    for part, run, letters in zip(parts, runs, ("abcdef", "ghijkl"), strict=True):
        _experiment(part, run, letters)
    return figure


def _experiment(figure: FigureBase, run: xr.Dataset, letters: str) -> None:
    flown, record = flights.until_loss(run), _record(run.attrs["name"])
    style.title(figure, run.attrs["title"], size=8.5)
    if record:
        style.footnote(figure, "pale: the real robot (in i our model with its joints); left leg; the true wind is zero")
    grid = figure.subplots(2, 3, sharex=True)
    com = flown["com_position"]
    moved = com.attrs | {"label": "CoM displacement", "shown": "mm"}
    panels.components(grid[0, 0], flown["measured_wind"])
    panels.components(grid[0, 1], flights.aero_force(flown, of_controller=True))
    panels.components(grid[0, 2], (com - com.sel(time=slice(*CALM)).mean("time")).assign_attrs(moved))
    for axes, name in zip(grid[1], ("joint_position", "joint_torque", "joint_torque_measured"), strict=True):
        _leg(axes, flown[name])
    if record:
        calm = (record["time"] >= CALM[0]) & (record["time"] <= CALM[1])
        air = [name for name in record if name.startswith("air/")]
        record |= {
            f"force_{a}": np.sum([record[name] for name in air if name.endswith(f"/{a}")], axis=0) for a in "xyz"
        }
        record |= {
            f"moved_{a}": shown(moved, record[f"com_{a}"] - record[f"com_{a}"][calm].mean()).values for a in "xyz"
        }
        for axes, prefix in zip(grid[0], ("wind_", "force_", "moved_"), strict=True):
            _pale(axes, record, {prefix + axis: colour for axis, colour in style.AXES_COLOURS.items()})
        for axes, prefix in zip(grid[1], ("q/l_", "tau_des/l_", "tau_meas/l_"), strict=True):
            _pale(axes, record, {prefix + name: colour for name, colour, _ in LEG})
    style.letters(grid.ravel(), letters)
    for axes in grid[0]:
        style.legend_above(axes, columns=3)
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    style.legend_above(grid[1, 0], columns=3)
    grid[0, 0].set_xlim(0.0, float(run["time"][-1]))
    for axes in grid.ravel():
        panels.mark_loss(axes, run, labelled=False)


def _leg(axes: Axes, joints: xr.DataArray) -> None:
    for name, colour, dash in LEG:
        signal = joints.sel(joint=f"l_{name}")
        panels.line(axes, signal, dash, color=colour, label=name.replace("_", " "), linewidth=0.9)


def _record(name: str) -> dict[str, Any]:
    """Return the columns of the real robot's record of an experiment; none of one that it did not do."""
    if find_spec("pyarrow") is None:  # which the extra of figures does not bring
        return {}
    from jax_aero.base.parquet import read_table

    kept = next((record for start, record in RECORDS.items() if name.startswith(start)), None)
    files = [] if kept is None else [places.CONFIGS / "records" / f"{kept}{part}.parquet" for part in ("", "_com")]
    tables = [read_table(path) for path in files if path.is_file()]
    return {column: table[column].to_numpy() for table in tables for column in table.column_names}


def _pale(axes: Axes, record: dict[str, Any], colours: dict[str, str]) -> None:
    for column, colour in colours.items():
        if column in record:
            axes.plot(record["time"], record[column], color=colour, **PALE)


FIGURES = {
    "fig6": Entry(
        draw,
        "Fig. 6 a-l: ground experiments in frontal and lateral wind",
        "flight",
        ("balancing_front_as_flown", "balancing_lateral_as_flown"),
    ),
}
