"""Compare our simulations with the wind tunnel, point by point: `jax-aero cfd tunnel NAME --set tunnel=FILE`.

NAME is a design of `jax-aero cfd`, FILE a dataset of `import-tunnel`. Each case is compared with the points of its
posture, speed and wind and, if the posture is its own mirror image, with the mirrored points of the mirrored wind.
Doubtful points are left out, except where the support is exposed to the wind: these are listed separately, since there
is no test of the support alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import xarray as xr

from jax_aero.aero.dataset import (
    MIRROR_AXES,
    Dataset,
    Floats,
    load,
    mirrored_joints,
    tunnel_from_base,
    wind_direction,
)
from jax_aero.aero.posture import NEWTON_METRES, axes_of, total_wrench
from jax_aero.base import run_file, tables
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.cfd.compute import dataset_of
from jax_aero.cfd.goals import verdicts
from jax_aero.results.study import Findings, Study

NEAR = 1.0
"""Greatest angle between the wind of a point and that of a case [deg]."""
SPEED = 1.0
"""Greatest difference of their speeds [m/s]."""
SUPPORT = "support"


class TunnelConfig(tables.Table, frozen=True):
    """Settings of a comparison."""

    tunnel: Path
    """Dataset of `import-tunnel`."""
    robot: Path = msgspec.field(default_factory=lambda: ROBOT)
    """Robot of the design, for its forward axis and its centre of mass."""
    dataset: Path | None = None
    """Dataset of the design; by default `results/cfd/NAME/dataset.nc`."""


class Row(NamedTuple):
    """A case and its points in the tunnel, base axes."""

    case: int
    """Row of the dataset."""
    is_alone: bool
    """Whether the support is not exposed to the wind."""
    force_area: Floats
    """(P, 3) of the points [m²]."""
    moment_com: Floats
    """(P, 3) of the points about the centre of mass [m³]; NaN if the robot's position on the balance is unknown."""
    moment_std: Floats
    """(P, 3) standard deviations of the moments, from the budget of `import-tunnel` [m³]."""


def compute(name: str, config: TunnelConfig) -> Findings:
    """Compare."""
    path = config.dataset or dataset_of(name)
    robot = load_robot(config.robot)
    ours = load(path, robot)
    rows = list(pair_cases(ours, run_file.read(config.tunnel), axes_of(robot)))
    if not rows:
        raise Refused(f"{config.tunnel} has no point of posture, wind and speed of a case of {path}")
    result = compare_cases(robot, ours, rows)
    return Findings(f"Open CFD `{name}` beside the wind tunnel", result, summary(result))


STUDY = Study(
    "cfd_tunnel",
    __doc__,
    TunnelConfig,
    compute,
    ("open",),
    backend="openfoam",
    reads=lambda name, config: [] if config.dataset else [dataset_of(name)],
)
main = STUDY.main


def pair_cases(ours: Dataset, points: xr.Dataset, axes: Floats) -> Iterator[Row]:
    """Yield every case that was measured, with its points."""
    alone = points["marks"].values.astype(str) == ""
    forces, moments = (points[key].values @ axes.T for key in ("force_area", "moment_com"))
    deviations = points["u_total"].values @ np.abs(axes).T  # for axes that differ by rotations of 90°
    for case, (near, twin) in enumerate(points_beside(ours, points, axes)):
        # A mirrored axial vector changes the sign of the other components.
        parts = [
            (forces[near], moments[near], deviations[near]),
            (forces[twin] * MIRROR_AXES, -moments[twin] * MIRROR_AXES, deviations[twin]),
        ]
        if (near | twin).any():
            is_alone = bool(alone[near | twin].all())
            yield Row(case, is_alone, *(np.concatenate(values) for values in zip(*parts, strict=True)))


def points_beside(ours: Dataset, points: xr.Dataset, axes: Floats) -> Iterator[tuple[Any, Any]]:
    """Yield for every case the points (P,) of its posture, speed and wind, and those of its mirror image."""
    marks = points["marks"].values.astype(str)
    winds = wind_direction(points["pitch"].values, points["yaw"].values) @ axes.T
    images = mirrored_joints(ours.joint_position_deg, ours.joints)
    for case in range(len(ours)):
        same = (points["posture"].values == ours.posture[case]) & ((marks == "") | (marks == SUPPORT))
        same &= np.abs(points["speed"].values - ours.speed[case]) < SPEED
        near = same & _is_near(winds, ours.wind_b[case])
        is_symmetric = np.allclose(images[case], ours.joint_position_deg[case])
        yield near, is_symmetric & same & ~near & _is_near(winds, ours.wind_b[case] * MIRROR_AXES)


def _is_near(winds: Floats, wind: Floats) -> Floats:
    return np.asarray(winds @ wind > np.cos(np.radians(NEAR)))


def compare_cases(robot: RobotModel, ours: Dataset, rows: list[Row]) -> xr.Dataset:
    """Return force and moment of every case, and mean, minimum and maximum over its points."""
    data = ours.take(np.array([row.case for row in rows]))
    volume = np.full((len(rows), 3), np.nan)
    measured = np.stack([row.moment_com.mean(axis=0) for row in rows])
    if np.isfinite(measured).all():
        volume = total_wrench(robot, data.joint_position(robot), data.force_area_b).moment_volume
        if data.couple_volume_b is not None:
            volume = volume + data.couple_volume_b.sum(axis=1)
    drags = [row.force_area @ wind for row, wind in zip(rows, data.wind_b, strict=True)]
    vector, area = ("case", "xyz"), {"units": "m2"}
    return xr.Dataset(
        {
            "force_area": (vector, data.force_area_b.sum(axis=1), area),
            "force_area_tunnel": (vector, np.stack([row.force_area.mean(axis=0) for row in rows]), area),
            "moment_com": (vector, volume, {"units": "m3"}),
            "moment_com_tunnel": (vector, measured, {"units": "m3"}),
            "moment_std_tunnel": (vector, np.stack([row.moment_std.mean(axis=0) for row in rows]), {"units": "m3"}),
            "wind": (vector, data.wind_b),
            "drag_tunnel_least": ("case", [values.min() for values in drags], area),
            "drag_tunnel_greatest": ("case", [values.max() for values in drags], area),
            "points": ("case", [len(values) for values in drags]),
        },
        {
            "posture": ("case", data.posture.astype(str)),
            "pitch": ("case", data.pitch_deg, {"units": "degree"}),
            "yaw": ("case", data.yaw_deg, {"units": "degree"}),
            "is_alone": ("case", np.array([row.is_alone for row in rows]).astype("i1")),
            "xyz": ["x", "y", "z"],
        },
    )


def summary(data: xr.Dataset) -> dict[str, float | str]:
    """Return the errors of every case, and their root mean squares without and with the support in the wind.

    Goals apply to the robot alone.
    """
    drag, measured = ((data[key] * data["wind"]).sum("xyz").values for key in ("force_area", "force_area_tunnel"))
    difference = (data["force_area"] - data["force_area_tunnel"]).values
    off = np.linalg.norm(difference, axis=1)
    across = np.einsum("nij,nj->ni", tunnel_from_base(data["pitch"].values, data["yaw"].values), difference)
    twist = (data["moment_com"] - data["moment_com_tunnel"]).values
    turned = NEWTON_METRES * np.linalg.norm(twist, axis=1)
    unsure = NEWTON_METRES * np.linalg.norm(data["moment_std_tunnel"].values, axis=1)
    alone = data["is_alone"].values == 1
    figures: dict[str, float] = {}
    for place, posture in enumerate(data["posture"].values):
        name = f"{posture} {data['pitch'].values[place]:.0f}/{data['yaw'].values[place]:.0f}"
        name += "" if alone[place] else ", support in the wind"
        figures |= {f"{name}: drag [m2]": drag[place], f"{name}: drag in the tunnel [m2]": measured[place]}
        for end in ("least", "greatest"):
            figures[f"{name}: drag in the tunnel, {end} [m2]"] = float(data[f"drag_tunnel_{end}"].values[place])
        figures |= {
            f"{name}: drag, relative error": drag[place] / measured[place] - 1.0,
            f"{name}: side less that in the tunnel [m2]": across[place, 1],
            f"{name}: lift less that in the tunnel [m2]": across[place, 2],
            f"{name}: total force, distance [m2]": off[place],
            f"{name}: moment, distance [N m at 10 m/s]": turned[place],
            f"{name}: moment, standard deviation of the tunnel's [N m at 10 m/s]": unsure[place],
        }
    for label, rows in (("robot alone", alone), ("support in the wind", ~alone)):
        if rows.any():
            figures[f"{label}: cases"] = int(rows.sum())
            figures[f"{label}: drag, relative error, rms"] = _rms(drag[rows] / measured[rows] - 1.0)
            figures[f"{label}: total force, rms [m2]"] = _rms(off[rows])
            figures[f"{label}: moment, rms [N m at 10 m/s]"] = _rms(turned[rows])
    goals = verdicts({key: value for key, value in figures.items() if key.startswith("robot alone")})
    return {key: float(value) for key, value in figures.items() if np.isfinite(value)} | goals


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
