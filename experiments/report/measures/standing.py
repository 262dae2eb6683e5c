"""Measures of a ground experiment: displacements, forces, and sums of contact forces."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero.base import flights, places
from jax_aero.base.parquet import read_table

GRAVITY = 9.81
VISIBLE = 1e-3
"""Least displacement of the CoM that is visible in a figure [m]."""
VISIBLE_SHIFT = 2e-3
"""Displacement of the CoM below which it counts as not moved [m]."""
CALM = 3.0
"""Duration of the calm before the wind, and of the end, over which means are taken [s]."""
SETTLED, STEADY = 1.0, 1.0
"""Time from which forces are balanced, and over which their impulse is taken [s]."""
RECORDS = places.CONFIGS / "records"

Signal: TypeAlias = NDArray[np.float64]


def standing(run: xr.Dataset, ramp_start: float, mass: float, axis: int) -> dict[str, Any]:
    """Measure a run whose wind along an axis begins to rise at `ramp_start` [s]; `mass` is the controller's [kg]."""
    time = run["time"].values
    calm = (time >= ramp_start - CALM) & (time < ramp_start)
    end = time >= time[-1] - CALM

    def mean_change(signal: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(signal[end].mean(axis=0) - signal[calm].mean(axis=0))

    com = (run["com_position"] - run["com_setpoint"]).values
    carried = run["feet_carry"].values == 1
    force = flights.aero_force(run, of_controller=True).values
    rate = run["momentum_rate_estimate"].values[:, :3]
    shift, assumed = mean_change(com), force[end].mean(axis=0)
    turned = np.degrees(mean_change(run["joint_position"].values))
    leg = {
        str(joint).removeprefix("l_").replace("_", " "): float(angle)
        for joint, group, angle in zip(run["joint"].values, run["joint_group"].values, turned, strict=True)
        if str(group) == "left_leg"
    }
    order = sorted(leg, key=lambda joint: -abs(leg[joint]))
    is_whole = not run.attrs["lost_reason"] and run.attrs["outcome"] == "completed"
    return moves(time, com[:, axis], rate, ramp_start) | {
        "ending": "stands to the end" if is_whole else flights.verdict(run),
        "is_completed": is_whole,
        "carry": "carry" if carried.all() else "carry not",
        "is_carried": bool(carried.all()),
        "axis": "xy"[axis],
        "shift_mm": 1e3 * float(shift[axis]),
        "force": float(assumed[axis]),
        "off_mm": 1e3 * float(shift[1 - axis]),
        "work": float(shift[axis] * assumed[axis]),
        "clear": abs(float(shift[axis])) / max(VISIBLE_SHIFT, 5.0 * abs(float(shift[1 - axis]))),
        "leg": ", ".join(f"{joint} {angle:+.2f}°" for joint, angle in leg.items()),
        "first": order[0],
        "first_two": sorted(order[:2]),
        "assumed": float(abs(assumed).max()),
        **balance(run, mass),
    }


def moves(time: Signal, com: Signal, rate: Signal, ramp_start: float) -> dict[str, float]:
    """Measure how a robot, simulated or recorded, moves along the wind, and its estimated linear momentum rate [N]."""
    calm, windy, end = (time >= ramp_start - CALM) & (time < ramp_start), time >= ramp_start, time >= time[-1] - CALM
    moved, horizontal = np.abs(com - com[calm].mean()) > VISIBLE, np.linalg.norm(rate[:, :2], axis=1)
    peak, rest = float(horizontal[windy].max()), float(horizontal[end].mean())
    return {
        "moved_mm": 1e3 * abs(float(com[end].mean() - com[calm].mean())),
        "rate_peak": peak,
        "rate_end": rest,
        "fallen": rest / peak,
        "onset": float(time[windy & moved][0] - ramp_start) if (windy & moved).any() else np.nan,
    }


def balance(run: xr.Dataset, mass: float) -> dict[str, float]:
    """Measure the momentum balance of a run whose robot has this mass [kg], over every `STEADY` seconds [N].

    The change of its momentum against the impulse of measured foot forces, simulated air and weight.
    """
    time = run["time"].values
    forces = run["foot_wrench"].sum("foot").values[:, :3] + flights.aero_force(run).values
    forces[:, 2] -= mass * GRAVITY
    steps = round(STEADY / (time[1] - time[0]))
    impulse = np.cumsum(forces[:-1] * np.diff(time)[:, None], axis=0)
    momentum = mass * run["com_velocity"].values[:-1]
    missing = (momentum[steps:] - momentum[:-steps] - impulse[steps:] + impulse[:-steps]) / STEADY
    return {
        "unbalanced": float(np.abs(missing[time[: len(missing)] >= SETTLED]).max()),
        "vertical": float(forces[time >= SETTLED, 2].mean()),
    }


def recorded(name: str, ramp_start: float, axis: int) -> dict[str, float]:
    """Measure a record of the real robot as `moves`."""
    rows = {key: values for path in RECORDS.glob(f"{name}*.parquet") for key, values in _columns(path).items()}
    rate = np.column_stack([rows["rate_lin_x"], rows["rate_lin_y"]])
    return moves(rows["time"], rows[f"com_{'xyz'[axis]}"], rate, ramp_start)


def _columns(path: Path) -> dict[str, Signal]:
    table = read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}
