"""What follows from the signals of a flight, as `run_file.read` returns it: its ending, errors and sums of forces."""

from __future__ import annotations

import math

import xarray as xr

from jax_aero.base.result import ending


def lost_time(flight: xr.Dataset) -> float | None:
    """Return when a flight was lost [s], or `None` if it reached its end."""
    time = float(flight.attrs["lost_time"])
    return None if math.isnan(time) else time


def verdict(flight: xr.Dataset) -> str:
    """Return how a flight ended: "completed", or "fell at 21.4 s (rotation error 90.1 deg)"."""
    return ending(str(flight.attrs["outcome"]), lost_time(flight), str(flight.attrs["lost_reason"]))


def com_error(flight: xr.Dataset) -> xr.DataArray:
    """Return the distance of the centre of mass from its set-point [m]."""
    return _norm(flight["com_position"] - flight["com_setpoint"])


def wind_speed(flight: xr.Dataset) -> xr.DataArray:
    """Return the speed of the wind [m/s]."""
    return _norm(flight["wind"])


def aero_force(flight: xr.Dataset, *, of_controller: bool = False) -> xr.DataArray:
    """Return the total aerodynamic force, of the simulator or as the controller compensates it [N, inertial axes]."""
    return flight["aero_force_control" if of_controller else "aero_force_sim"].sum("link")


def _norm(vectors: xr.DataArray) -> xr.DataArray:
    return (vectors**2).sum("xyz") ** 0.5
