"""Fig. 6: the ground experiments, a to f in a frontal and g to l in a lateral measured wind; the true wind is zero.

a, g  wind    b, h  total aerodynamic force assumed by the controller    c, i  CoM, from its place at the start
d, j  joints of the left leg    e, k  their commanded torques    f, l  torques on the joints
Pale lines: the real robot's record (`configs/records`), whose lateral run has no CoM.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase

from jax_aero.base import places
from paper_figs import panels, style
from paper_figs.runs import Run, Series

RECORDS = {"balancing_front": "standing_front_2", "balancing_lateral": "standing_lateral"}
"""The record of the run of a name, and of one that begins with it."""
PALE: dict[str, Any] = {"alpha": 0.4, "linewidth": 1.8}

LEG = (
    ("hip_pitch", style.VERMILION, "-"),
    ("hip_roll", style.GREEN, "-"),
    ("hip_yaw", style.GREY, "-"),
    ("knee", style.BLACK, "--"),
    ("ankle_pitch", style.ORANGE, "-"),
    ("ankle_roll", style.BLUE, "-"),
)
"""Joints of a leg, with colours and dashes."""


def draw(*runs: Run) -> Figure:
    """Draw the figure from two runs: the first in panels a to f, the second in g to l."""
    figure = style.figure(8.6)
    parts = figure.subfigures(2, 1, squeeze=False)[:, 0]
    for part, run, letters in zip(parts, runs, ("abcdef", "ghijkl"), strict=True):
        _experiment(part, run, letters)
    return figure


def _experiment(figure: FigureBase, run: Run, letters: str) -> None:
    flown, record = run.log_to_loss, _record(run.name)
    style.title(figure, run.title + (" (pale: the real robot)" if record else ""), size=8.5)
    grid = figure.subplots(2, 3, sharex=True)
    com = flown["com_position"]
    panels.components(grid[0, 0], flown["measured_wind"], "measured wind [m/s]")
    panels.components(grid[0, 1], flown["aero_force_control"].sum("link"), "aerodynamic force [N]")
    panels.components(grid[0, 2], 1e3 * (com - com.isel(time=0)), "CoM, from the start [mm]")
    _leg(grid[1, 0], flown["joint_position"] * (180.0 / np.pi), "left leg joints [deg]")
    _leg(grid[1, 1], flown["joint_torque"], "torques, desired [N m]")
    _leg(grid[1, 2], flown["joint_torque_measured"], "torques, at the joints [N m]")
    if record:
        air = [name for name in record if name.startswith("air/")]
        record |= {
            f"force_{a}": np.sum([record[name] for name in air if name.endswith(f"/{a}")], axis=0) for a in "xyz"
        }
        record |= {f"moved_{a}": 1e3 * (record[f"com_{a}"] - record[f"com_{a}"][0]) for a in "xyz" if "com_x" in record}
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
    grid[0, 0].set_xlim(0.0, float(run.data["time"][-1]))
    if run.lost_time is not None:
        for axes in grid.ravel():
            style.mark_fall(axes, run.lost_time)


def _leg(axes: Axes, joints: Series, label: str) -> None:
    for name, colour, dash in LEG:
        signal = joints.sel(joint=f"l_{name}")
        axes.plot(signal["time"], signal, dash, color=colour, label=name.replace("_", " "), linewidth=0.9)
    axes.set_ylabel(label)


def _record(name: str) -> dict[str, Any]:
    """Return the columns of the real robot's record of an experiment; none of one that it did not do."""
    if find_spec("pyarrow") is None:  # which the extra of figures does not bring
        return {}
    from jax_aero.base.parquet import read_table

    found = next((record for start, record in RECORDS.items() if name.startswith(start)), None)
    table = None if found is None else read_table(places.CONFIGS / "records" / f"{found}.parquet")
    return {} if table is None else {column: table[column].to_numpy() for column in table.column_names}


def _pale(axes: Axes, record: dict[str, Any], colours: dict[str, str]) -> None:
    for column, colour in colours.items():
        if column in record:
            axes.plot(record["time"], record[column], color=colour, **PALE)
