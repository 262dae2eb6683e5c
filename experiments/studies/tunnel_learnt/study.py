"""What a few postures of a wind tunnel teach about the others: the learner of `train flights` on a real balance.

Total force and moment about the centre of mass of 1, 3 and 10 postures, drawn several times, train a network from
nothing and on top of the nominal model, and refit that model's coefficients. All other postures judge, beside models
that have seen none: nominal, and the network of the authors' CFD. Errors are root mean squares in N and N m at 10 m/s;
their 95 % intervals resample postures and draws. Needs `results/datasets/tunnel_ROBOT.nc` of `import-tunnel`.

The result goes to `results/tunnel_learnt/ROBOT/`.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.aero.dataset import Floats, wind_direction
from jax_aero.aero.network import Network, baseline_areas, init_network, raw_output, to_base_axes
from jax_aero.aero.posture import axes_of, total_wrench
from jax_aero.base import run_file, tables
from jax_aero.base.places import CONFIGS
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.cfd.models import evaluate_areas
from jax_aero.data.ironcub import joint_position
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.train import Settings, fit, refit
from jax_aero.train import flights as observed
from jax_aero.train.wrench import ObservedWrenches, Windows

SPEED, DENSITY = 10.0, 1.225
"""Wind at which errors are stated [m/s], and density of the air [kg/m³]."""
BALANCE = ObservedWrenches(
    frame="link",
    layout="link",
    gain=(np.inf, np.inf),
    step=1.0,
    noise=(1.0, 0.3),
    deviation=(0.0, 0.0, 0.0),
    area=0.02,
    shrink=0.02,
)
"""A balance is not filtered, and has no constants; its errors [N, N m at 10 m/s] are those of the reduction."""
SETTINGS = Settings(epochs=200, learning_rate=3e-3, batch=66, schedule="cosine", validate_every=200)
ROWS = 264
"""Points of a training, the drawn ones again and again: one shape, compiled once."""
DRAWS = 2000
"""Of the bootstrap."""


class TunnelLearnt(tables.Table, frozen=True):
    """One file of the study."""

    dataset: Path
    """Dataset of `import-tunnel`."""
    robot: Path
    nominal: str
    """Coefficient set of the nominal model."""
    network: Path | None = None
    """Card of the network of CFD."""
    postures: tuple[tables.Count, ...] = (1, 3, 10)
    """Numbers of postures to learn from."""
    draws: tables.Count = 3
    """Draws of the postures."""
    seed: tables.Seed = 1


class Points(NamedTuple):
    """Measured points, N rows."""

    posture: NDArray[np.str_]
    joints: Floats
    """(N, n) [rad]"""
    wind: Floats
    """(N, 3) unit vectors of the air's motion, base axes."""
    wrench: Floats
    """(N, 6) force and moment about the centre of mass at 10 m/s, base axes [N, N m]."""


def read(path: Path, robot: RobotModel) -> Points:
    """Return the points of the robot alone that are not in doubt."""
    data = run_file.read(path)
    data = data.isel(point=np.asarray(data["robot_only"].values == 1))
    axes, pressure = axes_of(robot), 0.5 * DENSITY * SPEED**2
    known = np.isfinite(data["joint_position"].values).all(axis=1) & np.isfinite(data["moment_com"].values).all(axis=1)
    data = data.isel(point=known)
    return Points(
        posture=data["posture"].values.astype(str),
        joints=joint_position(robot, data["joint_position"].values),
        wind=wind_direction(data["pitch"].values, data["yaw"].values) @ axes.T,
        wrench=pressure * np.hstack([data["force_area"].values @ axes.T, data["moment_com"].values @ axes.T]),
    )


def windows(points: Points, network: Network, robot: RobotModel) -> Windows:
    """Return a window of one row for each point."""
    geometry, arms = observed.geometry_of(robot, points.joints)
    x, unit = observed.features_of(network, SPEED * points.wind, points.joints, geometry)
    count = len(x)
    parts = (
        x,
        np.tile(np.eye(3), (count, 1, 1)),
        np.full(count, 0.5 * DENSITY * SPEED**2),
        unit,
        geometry.rotations,
        geometry.axes,
        arms,
        points.wrench,
        np.ones(count),
    )
    blank = np.zeros(0, np.float32)
    alone = (np.asarray(part, np.float32)[:, None] for part in parts)
    return BALANCE.with_constants(Windows(*alone, blank, blank))  # type: ignore[call-arg]


def start_of(robot: RobotModel, base: Floats | None, seed: int) -> Network:
    """Return the network of `configs/training_flights/hover.toml`, with random weights."""
    return init_network(
        jax.random.key(seed),
        robot,
        hidden=(64, 64),
        blocks=("link_wind", "link_position"),
        activation="silu",
        mirror=True,
        frame="link",
        layout="link",
        baseline=None if base is None else jnp.asarray(base, jnp.float32),
        start="unit",
    )


def predict(network: Network, points: Windows) -> Floats:
    """Return the wrenches (N, 6) of a network [N, N m at 10 m/s]."""
    blank = points._replace(seen=np.zeros_like(points.seen), weight=np.ones_like(points.weight))
    sigma = np.repeat(BALANCE.noise, 3)
    found: Floats = np.asarray(_left(network, blank), np.float64) * sigma
    return found


@jax.jit
def _left(network: Network, points: Windows) -> Any:
    return jax.vmap(lambda one: BALANCE.errors(_areas(network, one), one).of_rows[0])(points)


def _areas(network: Network, one: Windows) -> Any:
    areas = to_base_axes(network.frame, network.layout, raw_output(network, one.x[0, 0]), one.rotations[0])
    if network.baseline is not None:
        areas = areas + baseline_areas(network.baseline, one.wind[0], one.axes[0])
    return areas[None]


def learn(robot: RobotModel, chosen: Windows, base: Floats | None, seed: int) -> Network:
    """Return a network that points have taught."""
    rows = np.resize(np.random.default_rng(seed).permutation(len(chosen.x)), ROWS)
    again = Windows(*(part[rows] for part in chosen))
    return fit(start_of(robot, base, seed), again, None, SETTINGS, seed, objective=BALANCE).network


def compute(_: str, asked: TunnelLearnt, work: Work) -> Findings:
    """Learn from some postures and judge by the others."""
    if not asked.dataset.is_file():
        raise Refused(f"no {asked.dataset.name}; make it with: jax-aero data import-tunnel --clone DIR")
    robot = load_robot(asked.robot)
    points = read(asked.dataset, robot)
    nominal, names = np.asarray(robot.aero_links.coefficients[asked.nominal]), np.unique(points.posture)
    every = windows(points, start_of(robot, None, 0), robot)
    fixed = {"nothing": np.zeros_like(points.wrench), "nominal": coefficients_wrench(nominal, every)}
    if asked.network is not None:
        table = rust.load_aero(CONFIGS / "aero/network.toml") | {"card": str(asked.network)}
        degrees = run_file.read(asked.dataset)  # its joints are those of tables, in their order
        kept = degrees.isel(point=np.asarray(degrees["robot_only"].values == 1))["joint_position"].values
        areas = evaluate_areas(robot, table, kept, SPEED * points.wind)
        total = total_wrench(robot, points.joints, areas)
        fixed["network of CFD"] = 0.5 * DENSITY * SPEED**2 * np.hstack([total.force_area, total.moment_volume])
    off: dict[tuple[int, str], list[tuple[NDArray[np.str_], Floats]]] = {}
    for count in asked.postures:
        for draw in range(asked.draws):
            chosen = np.random.default_rng([asked.seed, count, draw]).choice(names, count, replace=False)
            is_shown = np.isin(points.posture, chosen)
            found = _learnt(robot, every, is_shown, nominal, work, f"{count}-{draw}")
            for model, predicted in (found | fixed).items():
                error = (np.asarray(predicted) - points.wrench)[~is_shown]
                off.setdefault((count, model), []).append((points.posture[~is_shown], error))
            print(f"{count} postures, draw {draw + 1} of {asked.draws}", file=sys.stderr, flush=True)
    rng = np.random.default_rng(asked.seed)
    summary: dict[str, Any] = {
        f"{count} postures, {model}": figures(draws, rng) for (count, model), draws in off.items()
    }
    summary |= {"measured": rms(points.wrench)} | {"points": len(points.wind), "postures": len(names)}
    data = to_dataset(summary, asked.postures)
    return Findings(f"What postures of the tunnel teach, {robot.name}", data, summary, files=[asked.robot])


def coefficients_wrench(rows: Floats, points: Windows) -> Floats:
    """Return the wrenches (N, 6) of axisymmetric coefficients [N, N m at 10 m/s]."""
    blank = points._replace(seen=np.zeros_like(points.seen))
    left = np.asarray(refit.left(rows, blank, BALANCE).of_rows[:, 0], np.float64)
    found: Floats = left * np.repeat(BALANCE.noise, 3)
    return found


def _learnt(
    robot: RobotModel, every: Windows, is_shown: NDArray[np.bool_], nominal: Floats, work: Work, job: str
) -> dict[str, Any]:
    """Return what models that postures taught say of all points."""
    kept: dict[str, Any] | None = work.read_json(job)
    if kept is None:
        chosen = Windows(*(part[is_shown] for part in every))
        seed = int(job.rpartition("-")[2])
        networks = {
            "learnt from nothing": learn(robot, chosen, None, seed),
            "learnt on nominal": learn(robot, chosen, nominal, seed),
        }
        kept = {name: predict(network, every).tolist() for name, network in networks.items()}
        rows = refit.refit(robot, chosen, BALANCE, nominal)
        kept["refit"] = coefficients_wrench(rows, every).tolist()
        work.write_json(job, kept)
    return kept


def rms(errors: Floats) -> dict[str, float]:
    """Return root mean squares of force and moment."""
    square = errors**2
    return {
        "force [N]": float(np.sqrt(square[:, :3].sum(axis=1).mean())),
        "moment [N m]": float(np.sqrt(square[:, 3:].sum(axis=1).mean())),
    }


def figures(draws: Sequence[tuple[NDArray[np.str_], Floats]], rng: np.random.Generator) -> dict[str, float]:
    """Return root mean squares over all draws, with intervals that resample draws and the postures in them."""
    found = rms(np.concatenate([errors for _, errors in draws]))
    parts = []
    for postures, errors in draws:
        names, number = np.unique(postures, return_inverse=True)
        square = np.stack([(errors[:, :3] ** 2).sum(axis=1), (errors[:, 3:] ** 2).sum(axis=1)])
        parts.append((np.stack([np.bincount(number, one) for one in square]), np.bincount(number), len(names)))
    drawn = np.empty((DRAWS, 2))
    for row in drawn:
        total, count = np.zeros(2), 0
        for place in rng.integers(len(parts), size=len(parts)):
            sums, rows, postures = parts[place]
            again = rng.integers(postures, size=postures)
            total, count = total + sums[:, again].sum(axis=1), count + rows[again].sum()
        row[:] = np.sqrt(total / count)
    for name, ends in zip(("force", "moment"), np.quantile(drawn, (0.025, 0.975), axis=0).T, strict=True):
        unit = "N" if name == "force" else "N m"
        found |= {f"{name}, from [{unit}]": float(ends[0]), f"{name}, to [{unit}]": float(ends[1])}
    return found


def to_dataset(summary: Mapping[str, Any], postures: Sequence[int]) -> xr.Dataset:
    """Return the figures by number of postures and model."""
    models = list(dict.fromkeys(key.partition(", ")[2] for key in summary if ", " in key))
    keys = list(next(iter(summary.values())))
    cells = np.array([[[summary[f"{n} postures, {m}"][k] for k in keys] for m in models] for n in postures])
    return xr.Dataset(
        {"error": (("postures", "model", "figure"), cells)},
        {"postures": list(postures), "model": models, "figure": keys},
    )


STUDY = Study("tunnel_learnt", __doc__, TunnelLearnt, compute, ("mk1",), backend="jax", resumes=True)
main = STUDY.main
