"""Compare every model's moments with the wind tunnel.

Each model is evaluated at the measured points of iRonCub-Mk1, with the forces at the links' centres and at the points
of the published code, and compared with the measured moment about the centre of mass, for both possible sides of the
balance centre. Intervals are computed by drawing postures with replacement, and the balance centre within its tolerance
once for each campaign and mount. The result goes to `results/tunnel_moments/mk1/`; `jax-aero figures tunnel_moments`
draws it. Needs `results/datasets/tunnel_mk1.nc` of `import-tunnel`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import xarray as xr

from jax_aero.aero.dataset import Floats, tunnel_from_base
from jax_aero.aero.posture import NEWTON_METRES, link_frames, vector_rms
from jax_aero.base import run_file, tables
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.cfd.models import MODEL_FILES, model_areas
from jax_aero.data import tunnel
from jax_aero.data.import_cfd import OUT
from jax_aero.data.ironcub import joint_position
from jax_aero.results.study import Findings, Study

NOTHING = "no moment"
ARMS, SIDES = ("corrected arms", "published arms"), ("below", "above")
GROUPS = ("hovering", "flight", "all")
DRAWS, SEED = 1000, 1
ENDS = (0.025, 0.975)
ADDED = ("2.5 %", "97.5 %", "share above zero")


class MomentsConfig(tables.Table, frozen=True):
    """Settings of a comparison."""

    dataset: Path = msgspec.field(default_factory=lambda: OUT / "tunnel_mk1.nc")
    """Dataset from import-tunnel."""


def compute(_: str, config: MomentsConfig) -> Findings:
    """Evaluate and compare."""
    data, robot = read(config.dataset), load_robot(ROBOT)
    areas = model_areas(robot, data)
    result = compare_moments(robot, data, areas)
    inputs = {"draws": DRAWS, "seed": SEED, "points": result.sizes["point"]}
    return Findings("Models' moments beside the wind tunnel", result, summary(result), inputs=inputs, files=MODEL_FILES)


STUDY = Study("tunnel_moments", __doc__, MomentsConfig, compute, ("mk1",), backend="jax")
main = STUDY.main


def read(path: Path) -> xr.Dataset:
    """Return the points of the tunnel."""
    if not path.is_file():
        raise Refused(f"no {path.name}; make it with: jax-aero data import-tunnel --clone DIR")
    return run_file.read(path)


def compare_moments(robot: RobotModel, data: xr.Dataset, areas: Mapping[str, Floats]) -> xr.Dataset:
    """Return the moments of all models beside the measured ones, and their errors."""
    predicted = {name: moments(robot, data, of_links) for name, of_links in areas.items()}
    names = [NOTHING, *predicted]
    volumes = np.stack([np.zeros((2, data.sizes["point"], 3)), *predicted.values()])
    measured = np.stack([moment_about_com(data, side) for side in SIDES])
    errors, intervals, added = compare(data, volumes)
    arms, point = np.array(ARMS), ("point", "axis")
    return xr.Dataset(
        {
            "predicted": (("model", "arms", *point), volumes, {"units": "m3"}),
            "measured": (("side", *point), measured, {"units": "m3"}),
            "uncertainty": (point, data["u_total"].values, {"units": "m3"}),
            "rms": (("model", "arms", "side", "group"), errors, {"units": "N m", "long_name": "at 10 m/s"}),
            "interval": (("model", "arms", "side", "group", "end"), intervals, {"units": "N m"}),
            "added": (("model", "side", "group", "figure"), added, {"long_name": "by the published arms: N m, share"}),
        },
        {
            "model": names,
            "arms": arms,
            "side": list(SIDES),
            "group": list(GROUPS),
            "end": list(ENDS),
            "figure": list(ADDED),
            "axis": ["x", "y", "z"],
            **{name: data[name] for name in ("campaign", "test", "kind", "posture", "marks", "robot_only")},
            **{name: data[name] for name in ("pitch", "yaw", "speed")},
        },
    )


def moments(robot: RobotModel, data: xr.Dataset, areas: Floats) -> Floats:
    """Return moment volumes about the centre of mass (2, N, 3) [m³], base axes, by lever arm.

    The published arm adds a link's offset without rotating it into inertial axes; the robot has the attitude of flight,
    pitched in a lateral wind instead of yawed.
    """
    frames, offsets = (
        link_frames(robot, joint_position(robot, data["joint_position"].values)),
        np.asarray(robot.aero_links.centres),
    )
    from_com = frames.positions - frames.com[:, None]
    base_from_inertial = np.swapaxes(tunnel_from_base(data["pitch"].values, 0.0), -1, -2)
    right = from_com + np.einsum("nlij,lj->nli", frames.rotations, offsets)
    published = from_com + np.einsum("nij,lj->nli", base_from_inertial, offsets)
    return np.stack([np.cross(arms, areas).sum(axis=1) for arms in (right, published)])


def moment_about_com(data: xr.Dataset, side: str, more: Callable[[str, str], Floats] | None = None) -> Floats:
    """Return the measured moment volumes about the centre of mass (N, 3) [m³], base axes, for one side.

    `more(campaign, kind)` is added to the offset, balance axes [m].
    """
    kinds, campaigns = data["kind"].values, data["campaign"].values
    arms = np.zeros((len(kinds), 3))
    for kind in np.unique(kinds):
        for campaign in np.unique(campaigns):
            chosen = (kinds == kind) & (campaigns == campaign)
            offset = np.array(tunnel.LEVERS[str(kind), side].offset)
            offset = offset if more is None else offset + more(str(campaign), str(kind))
            arms[chosen] = tunnel.base_from_balance("mk1", str(kind)) @ offset
    arms += tunnel.HIP - data["com"].values
    moments: Floats = data["moment_balance"].values + np.cross(arms, data["force_area"].values)
    return moments


def compare(data: xr.Dataset, volumes: Floats) -> tuple[Floats, Floats, Floats]:
    """Return rms errors at 10 m/s (model, arms, side, group), their 95 % intervals, and that of the arms' effect.

    The last is (model, side, group, 3): 2.5 and 97.5 % quantiles of the published arms' rms error minus that of the
    corrected ones, and the share of draws in which it is positive.
    """
    alone = data["robot_only"].values == 1
    data, volumes = data.isel(point=alone), volumes[:, :, alone]
    kinds = data["kind"].values
    chosen = (kinds == "hovering", kinds == "flight", np.ones(len(kinds), dtype=bool))
    cluster = np.array([f"{c} {p}" for c, p in zip(data["campaign"].values, data["posture"].values, strict=True)])
    rng = np.random.default_rng(SEED)
    shape = (len(volumes), len(ARMS), len(SIDES), len(GROUPS))
    errors, drawn = np.zeros(shape), np.zeros((DRAWS, *shape))
    for s, side in enumerate(SIDES):
        square = _squares(volumes, moment_about_com(data, side))
        for g, rows in enumerate(chosen):
            errors[..., s, g] = np.sqrt(square[..., rows].mean(axis=-1))
        for draw in range(DRAWS):
            square = _squares(volumes, moment_about_com(data, side, _offsets(rng, side)))
            for g, rows in enumerate(chosen):
                weight = _resample(rng, cluster, rows)
                drawn[draw, ..., s, g] = np.sqrt(square @ weight / weight.sum())
    intervals = np.moveaxis(np.quantile(drawn, ENDS, axis=0), 0, -1) * NEWTON_METRES
    more = (drawn[:, :, 1] - drawn[:, :, 0]) * NEWTON_METRES
    added = np.concatenate([np.quantile(more, ENDS, axis=0), np.mean(more > 0.0, axis=0)[None]])
    return errors * NEWTON_METRES, intervals, np.moveaxis(added, 0, -1)


def _squares(volumes: Floats, measured: Floats) -> Floats:
    square: Floats = np.sum((volumes - measured) ** 2, axis=-1)
    return square


def _offsets(rng: np.random.Generator, side: str) -> Callable[[str, str], Floats]:
    """Draw one error of the offset for each campaign and mount."""

    def draw_offset(_campaign: str, kind: str) -> Floats:
        drawn: Floats = rng.normal(size=3) * np.array(tunnel.LEVERS[kind, side].deviation)
        return drawn

    return draw_offset


def _resample(rng: np.random.Generator, cluster: Any, rows: Any) -> Floats:
    """Return weights of the points for postures drawn with replacement."""
    names, number = np.unique(cluster[rows], return_inverse=True)
    count = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
    weight = np.zeros(len(cluster))
    weight[rows] = count[number]
    return weight


def summary(result: xr.Dataset) -> dict[str, float]:
    """Return rms errors with their intervals, and the effect of the published arms."""
    figures: dict[str, float] = {}
    alone = result["robot_only"] == 1
    for group in GROUPS:
        rows = alone if group == "all" else alone & (result["kind"] == group)
        own = vector_rms(result["uncertainty"].values[rows.values])
        figures[f"{group}: the measurement's own standard deviation [N m]"] = own * NEWTON_METRES
        for side in SIDES:
            for name in result["model"].values:
                for arms in ARMS if name != NOTHING else ARMS[:1]:
                    at = {"model": name, "side": side, "group": group, "arms": arms}
                    key = f"{group}, centre {side}, {name}, {arms}"
                    figures[f"{key}: rms [N m]"] = float(result["rms"].sel(at))
                    for text, value in zip(("2.5 %", "97.5 %"), result["interval"].sel(at).values, strict=True):
                        figures[f"{key}: {text}"] = float(value)
                if name != NOTHING:
                    added = result["added"].sel(model=name, side=side, group=group).values
                    key = f"{group}, centre {side}, {name}: published arms add"
                    figures |= {f"{key}, {text}": float(value) for text, value in zip(ADDED, added, strict=True)}
    return figures
