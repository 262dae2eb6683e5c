"""What one, three and ten postures in the wind tunnel teach of the air of all others.

The learner of `jax-aero train flights` gets the tunnel's balance in place of an observer: force and moment about the
centre of mass of iRonCub-Mk1, at 10 m/s. Postures are drawn in several orders; it learns from the first ones, and all
models are judged by the postures that come after the tenth. The result goes to `results/learnt_tunnel/mk1/`. Needs
`results/datasets/tunnel_mk1.nc` of `import-tunnel`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import xarray as xr
from msgspec import structs
from numpy.typing import NDArray

from jax_aero.aero.dataset import wind_direction
from jax_aero.aero.network import Network
from jax_aero.aero.network_card import load_network
from jax_aero.base import places, run_file, tables
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.data.import_cfd import OUT
from jax_aero.data.ironcub import joint_position
from jax_aero.results.study import Findings, Study
from jax_aero.train import fit, flights, from_flights, refit
from jax_aero.train.flights import Flight, Sampling
from jax_aero.train.from_flights import FlightTraining
from jax_aero.train.wrench import ObservedWrenches

SETTINGS = places.CONFIGS / "training_flights" / "hover.toml"
CFD = places.CONFIGS / "aero/networks/default.json"
NOMINAL = "corrected"
SPEED, AIR_DENSITY = 10.0, 1.225
"""At which force areas are forces [m/s, kg/m³]."""
BATCH = 64
LEARNERS = ("learnt", "learnt on nominal", "refit of nominal")
ALONE = Sampling(step=1.0, window=1.0, settling=0.0)
"""Every point is a window of its own: a balance is not filtered."""


class Tunnel(tables.Table, frozen=True):
    """Settings."""

    dataset: Path = msgspec.field(default_factory=lambda: OUT / "tunnel_mk1.nc")
    """Dataset of import-tunnel."""
    postures: tuple[tables.Count, ...] = (1, 3, 10)
    """Numbers of postures to learn from."""
    orders: tables.Count = 6
    """Orders in which postures are drawn."""
    steps: tables.Count = 750
    """Steps of a training."""
    noise: tuple[tables.Positive, tables.Positive] = (0.5, 0.4)
    """Standard deviations of force and moment [N, N m]; the latter's is mostly that of the balance centre's place."""
    seed: tables.Seed = 27570806  # 0x01a4b276, of the commit that states what it is to show
    """Of the orders and of the networks' weights."""


def points_of(data: xr.Dataset, robot: RobotModel) -> Flight:
    """Return the points of the robot alone as rows of a flight whose base does not turn, base axes."""
    wind = SPEED * wind_direction(data["pitch"].values, data["yaw"].values)
    pressure = 0.5 * AIR_DENSITY * SPEED**2
    count = data.sizes["point"]
    return Flight(
        "tunnel",
        ALONE.step,
        np.tile(np.eye(3), (count, 1, 1)),
        wind,
        np.asarray(joint_position(robot, data["joint_position"].values), np.float64),
        pressure * np.concatenate([data["force_area"].values, data["moment_com"].values], axis=1),
        np.ones(count, dtype=bool),
        (np.inf, np.inf),
        np.full(count, pressure),
    )


def take(points: Flight, rows: NDArray[np.int64]) -> Flight:
    """Return some points."""
    kept = {key: getattr(points, key)[rows] for key in ("turn", "air", "joints", "wrench", "is_valid", "pressure")}
    return points._replace(**kept)


def learn(
    asked: Tunnel, settings: FlightTraining, points: Flight, robot: RobotModel, seed: int
) -> tuple[Network, Network]:
    """Return the network and the coefficients that points teach."""
    shape = settings.network
    seen = settings.observed
    objective = ObservedWrenches(
        shape.frame, shape.layout, points.gain, points.step, asked.noise, (0.0, 0.0, 0.0), seen.area, seen.shrink
    )
    start = settings.start(robot, seed)
    windows = flights.windows([points], start, robot, objective, ALONE)
    batch = min(BATCH, len(windows.x))
    epochs = max(1, asked.steps // -(-len(windows.x) // batch))
    training = structs.replace(settings.training, epochs=epochs, batch=batch, validate_every=epochs)
    fitted = fit(start, windows, None, training, seed, objective=objective)
    nominal = np.asarray(robot.aero_links.coefficients[NOMINAL])
    return fitted.network, refit.as_network(robot, refit.refit(robot, windows, objective, nominal))


def errors(network: Network, points: Flight, robot: RobotModel) -> tuple[float, float]:
    """Return root mean squares of the errors of force and moment [N, N m]."""
    off = flights.network_wrench(network, points, np.arange(len(points.turn)), robot) - points.wrench
    return float(np.sqrt((off[:, :3] ** 2).sum(1).mean())), float(np.sqrt((off[:, 3:] ** 2).sum(1).mean()))


def split(names: Sequence[str], most: int, rng: np.random.Generator) -> tuple[list[str], set[str]]:
    """Return the first `most` postures of a drawn order, and those after them, which judge."""
    drawn = rng.permutation(sorted(set(names))).tolist()
    return drawn[:most], set(drawn[most:])


def compute(_: str, asked: Tunnel) -> Findings:
    """Learn from postures, and compare by others."""
    if not asked.dataset.is_file():
        raise Refused(f"no {asked.dataset.name}; make it with: jax-aero data import-tunnel --clone DIR")
    robot = load_robot(places.ROBOT)
    data = run_file.read(asked.dataset)
    data = data.isel(point=data["robot_only"].values == 1)
    points, names = points_of(data, robot), data["posture"].values.astype(str)
    coefficients = np.asarray(robot.aero_links.coefficients[NOMINAL])
    fixed: Mapping[str, Network] = {
        "nothing": refit.as_network(robot, np.zeros_like(coefficients)),
        "nominal": refit.as_network(robot, coefficients),
        "network of CFD": load_network(CFD, robot),
    }
    rng, most = np.random.default_rng(asked.seed), max(asked.postures)
    by_model: dict[str, list[tuple[float, float]]] = {name: [] for name in fixed}
    by_model |= {f"{model}, {count} postures": [] for count in asked.postures for model in LEARNERS}
    for order in range(asked.orders):
        first, last = split(names.tolist(), most, rng)
        judges = take(points, np.flatnonzero(np.isin(names, list(last))))
        for name, network in fixed.items():
            by_model[name].append(errors(network, judges, robot))
        for count in asked.postures:
            taught = take(points, np.flatnonzero(np.isin(names, first[:count])))
            for model, base in (("learnt", "none"), ("learnt on nominal", NOMINAL)):
                settings, _unused = from_flights.read_settings(SETTINGS, {"network.baseline": base})
                network, fitted = learn(asked, settings, taught, robot, asked.seed + order)
                by_model[f"{model}, {count} postures"].append(errors(network, judges, robot))
            by_model[f"refit of nominal, {count} postures"].append(errors(fitted, judges, robot))
        print(f"{time.process_time():.0f} s: {order + 1} of {asked.orders} orders", file=sys.stderr, flush=True)
    rows, nominal = np.array(list(by_model.values())), np.array(by_model["nominal"])
    summary: dict[str, Any] = {
        name: {
            "force [N]": float(np.median(of[:, 0])),
            "moment [N m]": float(np.median(of[:, 1])),
            "orders with a smaller error of the force than nominal": int(np.sum(of[:, 0] < nominal[:, 0])),
        }
        for name, of in zip(by_model, rows, strict=True)
    }
    own = 0.5 * AIR_DENSITY * SPEED**2 * data["u_total"].values
    summary["points, postures"] = [len(names), len(set(names))]
    summary["the moment's own standard deviation [N m]"] = float(np.sqrt((own**2).sum(axis=1).mean()))
    dataset = xr.Dataset(
        {
            "force": (("model", "order"), rows[:, :, 0], {"units": "N", "long_name": "rms error at 10 m/s"}),
            "moment": (("model", "order"), rows[:, :, 1], {"units": "N m", "long_name": "rms error at 10 m/s"}),
        },
        {"model": list(by_model)},
    )
    title = "What postures in the wind tunnel teach of others"
    weights = CFD.with_suffix(".safetensors")
    return Findings(title, dataset, summary, files=[SETTINGS, places.ROBOT, CFD, weights])


STUDY = Study("learnt_tunnel", __doc__, Tunnel, compute, ("mk1",), backend="jax")
main = STUDY.main
