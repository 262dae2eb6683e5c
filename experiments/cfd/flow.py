"""Keep the flow of one case for pictures: `jax-aero cfd-flow NAME`, NAME a posture.

Pressure on the robot, and velocity, pressure and turbulent viscosity in its plane of symmetry, as in the paper's
Fig. 3 c to f; `jax-aero figures cfd_flow` draws them. Needs OpenFOAM.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments import Refused
from experiments.cfd import foam
from experiments.cfd.geometry import Surface, robot_surfaces
from experiments.cfd.settings import Settings
from experiments.cfd.simulate import Unfit, make_mesh, solve
from experiments.import_cfd import known_postures
from experiments.study import CONFIGS, Findings, Study
from jax_aero import rust, tables
from jax_aero.aero.dataset import Floats, wind_direction

ROBOT = CONFIGS / "robot" / "ironcub_mk1.toml"
SAMPLED, FIELDS = "sampled", ("p", "U", "nut")
REACH = 1.5
"""How far from the robot the plane is kept [m]."""


class FlowConfig(tables.Table, frozen=True):
    """A picture; the settings are those of the recipe."""

    pitch_deg: float = 45.0
    """Of the robot's vertical axis above the horizontal wind; the paper's picture has 45."""
    yaw_deg: float = 0.0
    settings: Settings = Settings()


def compute(name: str, config: FlowConfig) -> Findings:
    """Simulate and sample."""
    foam.environment()
    known = known_postures()
    if name not in known:
        raise Refused(f"no posture `{name}`; there are {', '.join(known)}")
    surfaces = robot_surfaces(rust.Robot(ROBOT), known[name])
    wind = wind_direction(config.pitch_deg, config.yaw_deg)
    with tempfile.TemporaryDirectory(prefix="jax-aero-cfd-") as scratch:
        folder = Path(scratch)
        try:
            facts = make_mesh(surfaces, config.settings, folder)
        except (foam.Failed, Unfit) as reason:
            raise Refused(str(reason)) from None
        result = solve(surfaces, wind, config.settings, folder, facts, {SAMPLED: sampled(surfaces)})
        if result.reason:
            raise Refused(result.reason)
        wall, *fields = read_sampled(folder)
    air = config.settings.air
    near = np.abs(fields[0][:, :3]).max(axis=1) < REACH
    pressure, velocity, viscosity = (field[near, 3:] for field in fields)
    ratio = viscosity[:, 0] / air.viscosity
    drag = float(np.sum([*result.force_area_b.values()], axis=0) @ wind)
    wake = np.linalg.norm(velocity, axis=1) < 0.5 * air.speed
    data = as_dataset(fields[0][near, :3], pressure[:, 0], velocity, ratio, wall, in_plane(surfaces), air.speed)
    summary: dict[str, Any] = {
        "drag [m2]": drag,
        "pressure share of the force": result.quality["pressure share of the force"],
        "turbulent over molecular viscosity, largest in the plane": float(ratio.max()),
        "turbulent over molecular viscosity, median in the wake": float(np.median(ratio[wake])),
        "cells": facts.cells,
    }
    return Findings(f"Flow around {name} at {config.pitch_deg:g} degrees", data.assign_attrs(wind=wind), summary)


def sampled(links: Iterable[str]) -> dict[str, Any]:
    """Return what reports pressure on the links, and the fields in the plane of symmetry, at the end."""
    place = {"point": (0, 0, 0), "normal": (0, 1, 0)}
    plane = {"type": "cuttingPlane", "planeType": "pointAndNormal", "pointAndNormalDict": place, "interpolate": "false"}
    return {
        "type": "surfaces",
        "libs": ["sampling"],
        "fields": [*FIELDS],
        "surfaceFormat": "raw",
        "executeControl": "onEnd",
        "writeControl": "onEnd",
        "surfaces": {"plane": plane, "wall": {"type": "patch", "patches": [*links], "interpolate": "false"}},
    }


def read_sampled(folder: Path) -> list[Floats]:
    """Return rows of position and value: pressure on the wall, then pressure, velocity and viscosity in the plane."""
    at = foam.last_report(folder, SAMPLED)
    return [foam.read_raw(at / name) for name in ("p_wall.raw", *(f"{field}_plane.raw" for field in FIELDS))]


def in_plane(surfaces: Mapping[str, Surface]) -> Floats:
    """Return the triangles (T, 3, 3) [m] of the links that the plane of symmetry cuts."""
    triangles = [surface.triangles for surface in surfaces.values()]
    return np.concatenate([part for part in triangles if part[..., 1].min() < 0.0 < part[..., 1].max()])


def as_dataset(
    points: Floats, pressure: Floats, velocity: Floats, ratio: Floats, wall: Floats, triangles: Floats, speed: float
) -> xr.Dataset:
    """Return plane and wall with units; pressures as coefficients `p / (½ ρ V²)`."""
    single = "f4"  # pictures need no more
    q = 0.5 * speed**2  # the solver's pressure is over density
    return xr.Dataset(
        {
            "plane_position": (("cell", "xyz"), points.astype(single), {"units": "m"}),
            "plane_pressure": ("cell", (pressure / q).astype(single), {"long_name": "pressure coefficient"}),
            "plane_velocity": (
                ("cell", "xyz"),
                (velocity / speed).astype(single),
                {"long_name": "over the wind's speed"},
            ),
            "plane_viscosity": ("cell", ratio.astype(single), {"long_name": "turbulent over molecular viscosity"}),
            "wall_position": (("face", "xyz"), wall[:, :3].astype(single), {"units": "m"}),
            "wall_pressure": ("face", (wall[:, 3] / q).astype(single), {"long_name": "pressure coefficient"}),
            "triangles": (("triangle", "corner", "xyz"), triangles.astype(single), {"units": "m"}),
        },
        {"xyz": ["x", "y", "z"]},
    )


STUDY = Study("cfd_flow", __doc__, FlowConfig, compute, ("flight30",), engine="openfoam")
main = STUDY.main
