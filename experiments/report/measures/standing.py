"""Metrics of a ground experiment from its `run.nc`: displacements, forces, and sums of contact forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero.base import keys, places, run_file
from jax_aero.base.result import ending

GRAVITY = 9.81
VISIBLE = 1e-3
"""Least displacement of the CoM that is visible in a figure [m]."""
CALM = 3.0
"""Duration of the calm before the wind, and of the end, over which means are taken [s]."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Ground:
    """One ground experiment in numbers."""

    name: str
    completed: bool
    ending: str
    always_carried: bool
    shift: Vector
    """(3,) displacement of the CoM from before the wind to the end [m]."""
    force: Vector
    """(3,) total force that the controller assumes at the end [N]."""
    left_leg: dict[str, float]
    """Displacement of each joint of the left leg, by name without side [deg]."""
    rate_peak: float
    """Greatest horizontal momentum rate that the controller estimates after the wind begins to rise [N]."""
    rate_end: float
    onset: float
    """Time from the start of the ramp to the first visible motion of the CoM [s]; NaN if there is none."""
    identity: float
    """Greatest violation of "rate = foot forces + aerodynamic forces − weight" [N]."""
    vertical: tuple[float, float]
    """Vertical foot forces f_c* minus the weight, and minus weight and aerodynamic lift, at the end [N]."""


def read(folder: Path, config: Mapping[str, Any], mass: float) -> Ground | None:
    """Return the metrics of a result, or `None` unless a robot stands first in calm and then in wind.

    `mass` is the robot's [kg]; the controller's differs by its model error.
    """
    wind = keys.get(config, "disturbances.controller_wind")
    if not isinstance(wind, Mapping):
        return None
    with run_file.opened(folder / places.RUN_FILE) as opened:
        if "contact_force" not in opened:
            return None
        start = float(wind.get("ramp_start", 0.0))
        if not 0.0 < start <= float(opened["time"][-1]):
            return None
        scale = keys.get(config, "disturbances.model_error.mass_scale") or 1.0
        return measure(folder.name, opened, start, scale * mass)


def measure(name: str, run: xr.Dataset, ramp_start: float, mass: float) -> Ground:
    """Return the metrics of a run whose wind begins to rise at `ramp_start` [s]."""
    time: Vector = run["time"].values
    calm = (time >= ramp_start - CALM) & (time < ramp_start)
    end, windy = time >= time[-1] - CALM, time >= ramp_start

    def mean_change(signal: Vector) -> Vector:
        return np.asarray(signal[end].mean(axis=0) - signal[calm].mean(axis=0))

    com = (run["com_position"] - run["com_setpoint"]).values
    moved = np.linalg.norm(com - com[calm].mean(axis=0), axis=1) > VISIBLE
    force = run["aero_force_control"].sum("link").values
    feet = run["contact_force"].sum("foot").values[:, :3]
    rate = run["momentum_rate_estimate"].values[:, :3]
    expected = feet + force - np.array([0.0, 0.0, mass * GRAVITY])
    horizontal = np.linalg.norm(rate[:, :2], axis=1)
    joints = [str(joint) for joint in run["joint"].values]
    turned = np.degrees(mean_change(run["joint_position"].values))
    outcome = str(run.attrs["outcome"])
    vertical = float((feet[end, 2] - mass * GRAVITY).mean())
    return Ground(
        name=name,
        completed=outcome == "completed",
        ending=ending(outcome, run.attrs["lost_time"], run.attrs["lost_reason"])
        if run.attrs["lost_reason"]
        else "stands to the end",
        always_carried=bool((run["feet_carry"].values == 1).all()),
        shift=mean_change(com),
        force=np.asarray(force[end].mean(axis=0)),
        left_leg={
            joint.removeprefix("l_"): float(turned[index])
            for index, joint in enumerate(joints)
            if str(run["joint_group"].values[index]) == "left_leg"
        },
        rate_peak=float(horizontal[windy].max()),
        rate_end=float(horizontal[end].mean()),
        onset=float(time[windy & moved][0] - ramp_start) if (windy & moved).any() else np.nan,
        identity=float(np.abs(rate - expected)[run["feet_carry"].values == 1].max(initial=0.0)),
        vertical=(vertical, vertical + float(force[end, 2].mean())),
    )
