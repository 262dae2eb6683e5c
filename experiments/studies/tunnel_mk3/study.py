"""Compare the force areas of iRonCub-Mk3 with the wind tunnel of December 2023.

Every coefficient set of the robot is evaluated at the measured points, and a network if one is named. Points of equal
posture and wind are averaged; intervals are computed by drawing postures with replacement. Both signs of the yaw are
tested. The result goes to `results/tunnel_mk3/december/`. Needs `results/datasets/tunnel_mk3.nc` of `import-tunnel`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import msgspec
import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Floats, wind_direction
from jax_aero.aero.posture import NEWTON_METRES, axes_of, interval_by_posture, link_axes, total_wrench, vector_rms
from jax_aero.base import run_file, tables
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.cfd.models import evaluate_areas
from jax_aero.cfd.tunnel import SUPPORT
from jax_aero.data import fit, tunnel
from jax_aero.data.import_cfd import OUT
from jax_aero.data.import_tunnel import MK3
from jax_aero.data.ironcub import joint_position
from jax_aero.results.study import Findings, Study

SPEED = 17.0
"""Speed at which a model is evaluated; areas do not depend on it [m/s]."""
SIDE_WIND = 60.0
"""Least yaw of a side wind [deg]."""


class TunnelConfig(tables.Table, frozen=True):
    """Settings of a comparison."""

    tunnel: Path = msgspec.field(default_factory=lambda: OUT / "tunnel_mk3.nc")
    """Dataset of `import-tunnel`."""
    robot: Path = msgspec.field(default_factory=lambda: MK3)
    network: Path | None = None
    """Card of a network of `train` to compare too."""


Model: TypeAlias = Callable[[Floats, Floats], Floats]
"""Function from joint angles (N, 19) [deg] and unit winds (N, 3) to force areas (N, L, 3) [m²], base axes."""


class Points(NamedTuple):
    """Measured points, N rows, base axes."""

    posture: Any
    """(N,) names."""
    kind: Any
    """(N,) kinds of test, `hovering` or `flight`."""
    joints: Floats
    """(N, 19) [deg], order of `JOINTS`."""
    pitch: Floats
    """(N,) angle of the robot's vertical axis above the horizontal [deg]."""
    yaw: Floats
    """(N,) yaw about the tunnel's vertical [deg]."""
    wind: Floats
    """(N, 3) unit vectors of the air's motion."""
    force: Floats
    """(N, 3) force areas [m²]."""
    moment: Floats
    """(N, 3) moment volumes about the centre of mass [m³]."""

    def take(self, rows: Any) -> Points:
        """Return the selected points."""
        return Points(*(values[rows] for values in self))

    @property
    def drag(self) -> Floats:
        """Return the drag areas (N,) [m²]."""
        areas: Floats = np.sum(self.force * self.wind, axis=1)
        return areas


def compute(_: str, config: TunnelConfig) -> Findings:
    """Evaluate and compare."""
    if not config.tunnel.is_file():
        raise Refused(f"no {config.tunnel.name}; make it with: jax-aero data import-tunnel --clone DIR")
    robot = load_robot(config.robot)
    points = read_points(run_file.read(config.tunnel), axes_of(robot))
    groups = groups_of(points)
    summary: dict[str, Any] = signs_of_yaw(points)
    modelled = {}
    for name, model in models_of(robot, config.network).items():
        force, moment = modelled[name] = totals(robot, model, points)
        for group, rows in groups.items():
            of_group = errors(points.take(rows), force[rows], moment[rows])
            summary |= {f"{name}, {group}: {key}": value for key, value in of_group.items()}
    for group, rows in groups.items():
        of_group = errors(points.take(rows), np.zeros((rows.sum(), 3)), np.zeros((rows.sum(), 3)))
        key = "moment, rms [N m at 10 m/s]"
        summary |= {f"no moment, {group}: {key}": of_group[key]}
    return Findings("Force areas of iRonCub-Mk3 beside the wind tunnel", to_dataset(points, modelled), summary)


STUDY = Study("tunnel_mk3", __doc__, TunnelConfig, compute, ("december",), backend="jax")
main = STUDY.main


def read_points(data: xr.Dataset, axes: Floats) -> Points:
    """Return the points that are not in doubt, averaged over those of equal posture and wind, in `axes`."""
    marks = data["marks"].values.astype(str)
    data = data.isel(point=(marks == "") | (marks == SUPPORT))
    place = np.round(np.column_stack([data["pitch"].values, data["yaw"].values]))
    names = np.char.add(data["posture"].values.astype(str), [f" {p:.0f} {y:.0f}" for p, y in place])
    _, first, group = np.unique(names, return_index=True, return_inverse=True)

    def mean(values: Floats) -> Floats:
        total = np.zeros((len(first), *values.shape[1:]))
        np.add.at(total, group.reshape(-1), values)
        averaged: Floats = (total.T / np.bincount(group.reshape(-1))).T
        return averaged

    pitch, yaw = mean(data["pitch"].values), mean(data["yaw"].values)
    return Points(
        posture=data["posture"].values.astype(str)[first],
        kind=data["kind"].values.astype(str)[first],
        joints=data["joint_position"].values[first],
        pitch=pitch,
        yaw=yaw,
        wind=wind_direction(pitch, yaw) @ axes.T,
        force=mean(data["force_area"].values) @ axes.T,
        moment=mean(data["moment_com"].values) @ axes.T,
    )


def groups_of(points: Points) -> dict[str, Any]:
    """Return the rows (N,) of every group."""
    hovering, yaw = points.kind == "hovering", np.abs(points.yaw)
    limit = tunnel.EXPOSED["hovering"]
    return {
        "flight postures": ~hovering & (yaw <= tunnel.EXPOSED["flight"]),
        "hovering, yaw to 20 deg": hovering & (yaw <= limit),
        "side wind": hovering & (yaw >= SIDE_WIND - 0.5),
    }


def models_of(robot: RobotModel, network: Path | None) -> dict[str, Model]:
    """Return the robot's coefficient sets and the network as functions."""

    def axisymmetric(coefficients: Floats) -> Model:
        return lambda joints, wind: fit.predicted_areas(
            coefficients, link_axes(robot, joint_position(robot, joints)), wind
        )

    models = {name: axisymmetric(np.asarray(areas)) for name, areas in robot.aero_links.coefficients.items()}
    if network:
        table = {"model": "network", "card": str(network), "precision": "f32", "air_density": 1.225}
        models["network"] = lambda joints, wind: evaluate_areas(robot, table, joints, SPEED * wind)
    return models


def totals(robot: RobotModel, model: Model, points: Points) -> tuple[Floats, Floats]:
    """Return force areas (N, 3) [m²] and moment volumes about the centre of mass (N, 3) [m³] of a model."""
    force, moment = total_wrench(robot, joint_position(robot, points.joints), model(points.joints, points.wind))
    return force, moment


def errors(points: Points, force: Floats, moment: Floats) -> dict[str, float]:
    """Return errors of forces [m²] and moments [m³], with 95 % intervals over postures."""
    off = force - points.force
    drag = np.sum(off * points.wind, axis=1, keepdims=True)
    mean = np.mean(points.drag)
    parts = {
        "drag, rms over mean": drag / mean,
        "lateral force, rms [m2]": off[:, 1:2],
        "force across the wind, rms [m2]": off - drag * points.wind,
        "moment, rms [N m at 10 m/s]": NEWTON_METRES * (moment - points.moment),
    }
    figures: dict[str, float] = {"points": len(off), "postures": len(np.unique(points.posture))}
    figures["drag, mean over mean"] = float(drag.mean() / mean)
    for name, values in parts.items():
        figures[name] = vector_rms(values)
        for end, value in zip(("2.5 %", "97.5 %"), interval_by_posture(values, points.posture), strict=True):
            figures[f"{name}, {end}"] = value
    return figures


def signs_of_yaw(points: Points) -> dict[str, float]:
    """Return what forces say of the sign of the yaw: a force against the wind is none of the air."""
    rows = np.abs(points.yaw) > 5.5
    figures: dict[str, float] = {}
    for name, sign in (("opposite to the files'", 1.0), ("the files'", -1.0)):
        wind = points.wind * [1.0, sign, 1.0]
        figures[f"yaw {name}: lateral force with the wind, share"] = float(
            np.mean((points.force * wind)[rows, 1] > 0.0)
        )
        drag = np.sum(points.force * wind, axis=1)[groups_of(points)["side wind"]]
        figures[f"yaw {name}: mean drag in side wind [m2]"] = float(drag.mean())
    return figures


def to_dataset(points: Points, modelled: dict[str, tuple[Floats, Floats]]) -> xr.Dataset:
    """Return measured and modelled totals."""
    names = list(modelled)
    vector, area, volume = ("point", "xyz"), {"units": "m2"}, {"units": "m3"}
    return xr.Dataset(
        {
            "force_area": (vector, points.force, area),
            "moment_com": (vector, points.moment, volume),
            "force_area_model": (("model", *vector), np.stack([modelled[name][0] for name in names]), area),
            "moment_com_model": (("model", *vector), np.stack([modelled[name][1] for name in names]), volume),
            "wind": (vector, points.wind),
        },
        {
            "model": names,
            "xyz": ["x", "y", "z"],
            "posture": ("point", points.posture.astype(str)),
            "kind": ("point", points.kind.astype(str)),
            "pitch": ("point", points.pitch, {"units": "degree"}),
            "yaw": ("point", points.yaw, {"units": "degree"}),
        },
    )
