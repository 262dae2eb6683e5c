"""What follows from the signals of a flight, as `run_file.read` returns it: its ending, errors and sums of forces."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from jax_aero.base import crate
from jax_aero.base.quantities import attributes_of
from jax_aero.base.result import ending


def lost_time(flight: xr.Dataset) -> float | None:
    """Return when a flight was lost [s], or `None` if it reached its end."""
    time = float(flight.attrs["lost_time"])
    return None if math.isnan(time) else time


def verdict(flight: xr.Dataset) -> str:
    """Return how a flight ended: "completed", or "fell at 21.4 s (rotation error 90.1 deg)"."""
    return ending(str(flight.attrs["outcome"]), lost_time(flight), str(flight.attrs["lost_reason"]))


def ending_at(flight: xr.Dataset) -> str:
    """Return how and when a flight ended: "fell at 21.4 s", "landed at 30.2 s"."""
    lost = lost_time(flight)
    return f"{flight.attrs['outcome']} at {float(flight['time'][-1]) if lost is None else lost:.1f} s"


def until_loss(flight: xr.Dataset) -> xr.Dataset:
    """Return a flight up to its loss, after which values are not meaningful and may be unbounded."""
    return flight.sel(time=slice(None, lost_time(flight)))


def rotation_error(flight: xr.Dataset) -> xr.DataArray:
    """Return the angle between base and set-point [rad]."""
    return flight["rotation_error"]


def com_error(flight: xr.Dataset) -> xr.DataArray:
    """Return the distance of the centre of mass from its set-point [m]."""
    return _norm(flight["com_position"] - flight["com_setpoint"]).assign_attrs(_as("max_com_error", "CoM error"))


def wind_speed(flight: xr.Dataset) -> xr.DataArray:
    """Return the speed of the wind [m/s]."""
    return _norm(flight["wind"]).assign_attrs(flight["wind"].attrs, label="wind speed")


def joint_error_sums(flight: xr.Dataset) -> xr.DataArray:
    """Return the sum of absolute joint errors of each group [rad], dims time and group, in the robot's order."""
    errors = abs(flight["joint_position"] - flight["joint_setpoint"])
    group_of = flight["joint_group"].values
    groups = list(dict.fromkeys(group_of.tolist()))
    sums = np.zeros((flight.sizes["time"], len(groups)))
    for column, group in enumerate(groups):
        sums[:, column] = errors.values[:, group_of == group].sum(axis=1)
    coords = {"time": flight["time"], "group": groups}
    return xr.DataArray(
        sums, coords, ("time", "group"), attrs=_as("max_joint_error_sum", "joint errors, sum over a limb")
    )


def aero_force(flight: xr.Dataset, *, of_controller: bool = False) -> xr.DataArray:
    """Return the total aerodynamic force, of the simulator or as the controller compensates it [N, inertial axes]."""
    return flight["aero_force_control" if of_controller else "aero_force_sim"].sum("link", keep_attrs=True)


def aero_force_difference(flight: xr.Dataset) -> xr.DataArray:
    """Return the simulator's total aerodynamic force minus the controller's [N, inertial axes]."""
    simulated = aero_force(flight)
    difference = simulated - aero_force(flight, of_controller=True)
    return difference.assign_attrs(simulated.attrs, label="force difference")


def _as(figure: str, label: str) -> dict[str, str]:
    """Return the attributes of a figure of merit for the quantity whose extreme it is."""
    return attributes_of(crate.figures()[figure]) | {"label": label}


def _norm(vectors: xr.DataArray) -> xr.DataArray:
    return (vectors**2).sum("xyz") ** 0.5
