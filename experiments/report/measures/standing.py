"""Measures of a ground experiment: displacements, forces, and sums of contact forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero.base import flights

GRAVITY = 9.81
VISIBLE = 1e-3
"""Least displacement of the CoM that is visible in a figure [m]."""
VISIBLE_SHIFT = 2e-3
"""Displacement of the CoM below which it counts as not moved [m]."""
CALM = 3.0
"""Duration of the calm before the wind, and of the end, over which means are taken [s]."""


def standing(run: xr.Dataset, ramp_start: float, mass: float, axis: int) -> dict[str, Any]:
    """Measure a run whose wind along an axis begins to rise at `ramp_start` [s]; `mass` is the controller's [kg]."""
    time = run["time"].values
    calm = (time >= ramp_start - CALM) & (time < ramp_start)
    end, windy = time >= time[-1] - CALM, time >= ramp_start

    def mean_change(signal: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(signal[end].mean(axis=0) - signal[calm].mean(axis=0))

    com = (run["com_position"] - run["com_setpoint"]).values
    moved = np.linalg.norm(com - com[calm].mean(axis=0), axis=1) > VISIBLE
    carried = run["feet_carry"].values == 1
    force = flights.aero_force(run, of_controller=True).values
    feet = run["contact_force"].sum("foot").values[:, :3]
    rate = run["momentum_rate_estimate"].values[:, :3]
    balance = feet + force - np.array([0.0, 0.0, mass * GRAVITY])
    horizontal = np.linalg.norm(rate[:, :2], axis=1)
    shift, assumed = mean_change(com), force[end].mean(axis=0)
    turned = np.degrees(mean_change(run["joint_position"].values))
    leg = {
        str(joint).removeprefix("l_").replace("_", " "): float(angle)
        for joint, group, angle in zip(run["joint"].values, run["joint_group"].values, turned, strict=True)
        if str(group) == "left_leg"
    }
    order = sorted(leg, key=lambda joint: -abs(leg[joint]))
    peak, rest = float(horizontal[windy].max()), float(horizontal[end].mean())
    vertical = float((feet[end, 2] - mass * GRAVITY).mean())
    strength = float(abs(assumed).max())
    is_whole = not run.attrs["lost_reason"] and run.attrs["outcome"] == "completed"
    return {
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
        "rate_peak": peak,
        "rate_end": rest,
        "assumed": strength,
        "fallen": rest / peak,
        "share": rest / strength if rest < peak else 0.0,
        # The greatest violation of "rate = foot forces + aerodynamic forces − weight" [N].
        "identity": float(np.abs(rate - balance)[carried].max(initial=0.0)),
        "vertical": vertical,
        "lifted": vertical + float(force[end, 2].mean()),
        "onset": float(time[windy & moved][0] - ramp_start) if (windy & moved).any() else np.nan,
    }
