"""Metrics of one flight in a report, from its `run.nc`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero.base import places, run_file
from jax_aero.base.result import ending
from jax_aero.rust import SETTLING_TIME

WINDY = 3.0
"""Least relative wind whose direction is meaningful [m/s]."""
FINAL = 3.0
"""Duration of the end of a flight, at rest in the paper's mission [s]."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Metrics:
    """Metrics of one flight, with angles in degrees."""

    name: str
    title: str
    ending: str
    com_error: float
    """Greatest position error after settling [m]; NaN if the flight ended before."""
    rotation_error: float
    joint_errors: dict[str, float]
    """Greatest sum of absolute joint errors, by group [deg]."""
    joint_error_at_end: float
    """Sum of joint errors over all joints, mean of the last seconds [deg]."""
    joint_error_max: float
    thrust: tuple[float, float]
    asymmetry: tuple[float, float]
    """Greatest difference between left and right thrust after settling: arms, chest [N]."""
    force: float
    """Greatest total aerodynamic force [N]."""
    force_difference: float
    """Greatest difference between the simulator's and the controller's total force [N]."""
    difference_time: float
    force_angle: tuple[float, float]
    """Angle between the total force and the relative wind: median and greatest [deg]."""


def read(folder: Path) -> Metrics:
    """Return the metrics of a flight's result."""
    with run_file.opened(folder / places.RUN_FILE) as opened:
        return measure(folder.name, opened)  # which loads the signals it needs


def measure(name: str, run: xr.Dataset) -> Metrics:
    """Return the metrics of a flight up to its loss; as in its summary, without the row in which it diverged."""
    if run.attrs["outcome"] == "diverged":
        run = run.isel(time=slice(-1))
    time: Vector = run["time"].values
    settled = time >= SETTLING_TIME
    position_error = (run["com_position"] - run["com_setpoint"]).values
    distance: Vector = np.linalg.norm(position_error, axis=1)[settled]
    error = np.degrees(np.abs((run["joint_position"] - run["joint_setpoint"]).values))
    groups = run["joint_group"].values
    simulated, estimated = (run[f"aero_force_{side}"].sum("link").values for side in ("sim", "control"))
    difference = np.linalg.norm(simulated - estimated, axis=1)
    thrust = run["thrust"].values if run.sizes["jet"] else np.zeros(1)  # as in a summary
    return Metrics(
        name=name,
        title=str(run.attrs["title"]),
        ending=ending(str(run.attrs["outcome"]), run.attrs["lost_time"], run.attrs["lost_reason"]),
        com_error=float(distance.max()) if distance.size else np.nan,
        rotation_error=float(np.degrees(run["rotation_error"].max())),
        joint_errors={
            str(group): float(error[:, groups == group].sum(axis=1).max()) for group in dict.fromkeys(groups.tolist())
        },
        joint_error_at_end=float(error[time >= time[-1] - FINAL].sum(axis=1).mean()),
        joint_error_max=float(error.sum(axis=1).max()),
        thrust=(float(thrust.min()), float(thrust.max())),
        asymmetry=_asymmetry(run, settled),
        force=float(np.linalg.norm(simulated, axis=1).max()),
        force_difference=float(difference.max()),
        difference_time=float(time[difference.argmax()]),
        force_angle=_force_angle((run["wind"] - run["com_velocity"]).values, simulated),
    )


def _asymmetry(run: xr.Dataset, settled: NDArray[np.bool_]) -> tuple[float, float]:
    jets = [str(jet) for jet in run["jet"].values]
    thrust = run["thrust"].values[settled]

    def difference(part: str) -> float:
        pair = [index for index, jet in enumerate(jets) if part in jet]
        return float(np.abs(thrust[:, pair[0]] - thrust[:, pair[1]]).max(initial=0.0)) if len(pair) == 2 else np.nan

    return difference("arm"), difference("chest")


def _force_angle(air: Vector, force: Vector) -> tuple[float, float]:
    windy = np.linalg.norm(air, axis=1) > WINDY
    if not windy.any():
        return np.nan, np.nan
    air, force = air[windy], force[windy]
    cos = (air * force).sum(axis=1) / np.linalg.norm(air, axis=1) / np.maximum(np.linalg.norm(force, axis=1), 1e-12)
    angle = np.degrees(np.arccos(np.clip(cos, -1.0, 1.0)))
    return float(np.median(angle)), float(angle.max())
