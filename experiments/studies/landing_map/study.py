"""From which speed, height and lean an engine's loss can be landed, and for how long a mission is where it cannot.

`jax-aero study landing_map` lets robots of one robot's world climb and fly ahead, and stops an engine where they
accelerate most, are fastest, or brake most. The share of robots that land, by speed, height and lean, is the map. The
flight of a mission through it says for how long each engine's loss is *outside*: where fewer land than `share`. Beside
it stands what robots do that lose the engine there. The result goes to `results/landing_map/robot/`.
"""

from __future__ import annotations

import copy
import itertools
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.results.study import Findings, Study, find
from jax_aero.robot import waypoints
from jax_aero.robot.waypoints import PEAK, Step, Waypoints
from jax_aero.sweep.perturbation import Perturbation

Array = NDArray[np.float64]

STEEPEST = 0.5 - 0.05**0.5
"""Place on a way of waypoints at which it accelerates most, as a share of its duration."""
PHASES = {"accelerating": STEEPEST, "fastest": 0.5, "braking": 1.0 - STEEPEST}
"""Places at which engines stop; at each the lean is `lean_deg`, none, or backwards as much."""
ACCELERATION = 420.0 * (STEEPEST * (1.0 - STEEPEST)) ** 2 * (1.0 - 2.0 * STEEPEST)
"""Greatest acceleration of a way, relative to its length over the square of its duration."""
CLIMB, REST = 4.0, 2.0
"""Durations of the climb and of the hover after it [s]: the wind has risen by then."""
ON_GROUND = 0.11
"""Height of a fall that is a landing [m]: it ends at 1.5 m/s."""
SAMPLE = 0.1
"""Time between the states of a mission [s]."""


class LandingMap(tables.Table, frozen=True):
    """States and missions."""

    experiment: str = "robot"
    """Robot, world, controller and the first mission."""
    missions: tuple[str, ...] = ("leaning_11", "quick_climb")
    """Other missions, recorded ones of `configs/mission`."""
    engines: tuple[str, ...] = ("l_arm_jet", "chest_l_jet")
    heights: tuple[tables.Positive, ...] = (1.0, 2.0, 5.0)
    """Above the ground [m]."""
    speeds: tuple[tables.Positive, ...] = (6.0, 12.0)
    """Ahead, beside hover [m/s]."""
    lean_deg: tables.Positive = 20.0
    """Greatest lean of a way [deg]."""
    robots: tables.Count = 8
    """Perturbed robots for each state."""
    share: tables.Positive = 0.85
    """Share of robots that land inside."""
    every: tables.Positive = 6.0
    """Time between losses on missions [s]."""
    seed: tables.Seed = 1

    def __post_init__(self) -> None:
        tables.check_levels(self, "engines", "heights", "speeds")


def way(asked: LandingMap, gravity: float, height: float, speed: float, place: float) -> tuple[Waypoints, float]:
    """Return a way with this height and speed at a place on it, and when it is there [s].

    `v_max = PEAK D/T`, `a_max = ACCELERATION D/T²` and `v = v_max (4 s (1 − s))³` with D, T of the way
    and s of `place`.
    """
    steps = [Step(climb_to=height, speed=PEAK * height / CLIMB), Step(hold=REST)]
    before = CLIMB + REST
    if speed > 0.0:
        fastest = speed / (4.0 * place * (1.0 - place)) ** 3
        duration = ACCELERATION / PEAK * fastest / (gravity * np.tan(np.radians(asked.lean_deg)))
        steps.append(Step(forward=fastest * duration / PEAK, speed=fastest))
        before += place * duration
    points = Waypoints(
        experiment=find("experiments", asked.experiment), title="A way", start=5.0, lean=True, steps=tuple(steps)
    )
    return points, points.start + before


def lost(config: rust.Config, engine: str, time: float, height: float) -> rust.Config:
    """Return a flight whose engine stops at a time [s], with enough time to come down from a height [m]."""
    failure = {"jet": engine, "time": time, "kind": "off"}
    duration = time + 10.0 + height / config["controller"]["setpoint"]["descent_speed"]
    return rust.set_keys(config, {"disturbances.jets.failure": failure, "simulator.duration": duration})


def landed(asked: LandingMap, robot: rust.Robot, losses: Sequence[rust.Config]) -> Array:
    """Return the share of perturbed robots that land, for each loss."""
    widths, drawn = tables.load(find("perturbation", "robot"), Perturbation), []
    for loss, repeat in itertools.product(losses, range(asked.robots)):
        drawn.append(copy.deepcopy(loss))
        widths.apply(drawn[-1], asked.seed, repeat, robot)
    outcomes = [flight.outcome == "landed" for flight in rust.fly_batch(drawn)]
    return np.asarray(np.reshape(outcomes, (len(losses), asked.robots)).mean(axis=1))


def map_of(asked: LandingMap, config: rust.Config, robot: rust.Robot, folder: Path) -> xr.DataArray:
    """Return the shares that land by engine, lean [deg, forwards], speed [m/s] and height [m]."""
    cells = list(itertools.product(PHASES.values(), (0.0, *asked.speeds), asked.heights))
    # A hover has no lean: its robots fly once.
    alike = [(place if speed else 0.5, speed, height) for place, speed, height in cells]
    losses: dict[tuple[float | str, ...], rust.Config] = {}
    for place, speed, height in dict.fromkeys(alike):
        points, time = way(asked, robot.gravity, height, speed, place)
        mission, _ = waypoints.write(Path("way.toml"), points, folder / str(len(losses)))
        flight = {**config, "mission": {"file": str(mission)}}
        for engine in asked.engines:
            losses[place, speed, height, engine] = lost(flight, engine, time, height)
    shares = dict(zip(losses, landed(asked, robot, list(losses.values())), strict=True))
    axes: dict[str, Any] = {
        "lean": asked.lean_deg * np.array([1.0, 0.0, -1.0]),
        "speed": [0.0, *asked.speeds],
        "height": list(asked.heights),
        "engine": list(asked.engines),
    }
    values = [shares[*cell, engine] for cell, engine in itertools.product(alike, asked.engines)]
    return xr.DataArray(np.reshape(values, [len(of) for of in axes.values()]), axes, tuple(axes))


def states_of(config: rust.Config) -> xr.Dataset:
    """Return speed [m/s], height [m] and lean ahead [deg] of a mission's flight in the air, over time [s]."""
    log, (_, _, ahead) = rust.fly(config).log, waypoints.start_of(config)
    height = log["com_position"][:, 2] - log["com_position"][0, 2]
    up = rust.rotation_from_wxyz(log["base_quaternion"])[:, :, 2]
    states = {
        "speed": np.linalg.norm(log["com_velocity"][:, :2], axis=1),
        "height": height,
        "lean": np.degrees(np.arcsin(np.clip(up @ ahead, -1.0, 1.0))),
    }
    aloft = np.flatnonzero(height > ON_GROUND)
    chosen = slice(aloft[0], aloft[-1] + 1, round(SAMPLE / config["controller"]["time_step"]))
    return xr.Dataset({key: ("time", one[chosen]) for key, one in states.items()}, {"time": log["time"][chosen]})


def shares_at(share: xr.DataArray, states: xr.Dataset) -> xr.DataArray:
    """Return the map's shares at states, linear between its own, and beyond them those of the nearest."""
    inside = {str(key): one.clip(share[key].min(), share[key].max()) for key, one in states.items()}
    return share.interp(inside).drop_vars(list(inside))


def compute(_: str, asked: LandingMap) -> Findings:
    """Fly the map, then the missions."""
    config = rust.load_config(asked.experiment)
    robot = rust.Robot(config["robot"])
    files = {name: places.CONFIGS / "mission" / f"{name}.csv" for name in asked.missions}
    with tempfile.TemporaryDirectory() as folder:
        share = map_of(asked, config, robot, Path(folder))
    flights = {asked.experiment: config}
    flights |= {name: {**config, "mission": {"file": str(path)}} for name, path in files.items()}
    rows = []
    for flight in flights.values():
        states = states_of(flight)
        start, end, top = float(states["time"][0]), float(states["time"][-1]), float(states["height"].max())
        times = np.arange(start, end, asked.every)
        losses = [lost(flight, engine, time, top) for engine, time in itertools.product(asked.engines, times)]
        flown = landed(asked, robot, losses).reshape(len(asked.engines), times.size)
        seen = {
            "map": shares_at(share, states),
            "flown": (("engine", "loss"), flown),
            "at": ("loss", times),
            "loss": np.arange(times.size),
            "aloft": end - start,
        }
        rows.append(states.rename({key: f"mission_{key}" for key in states}).assign(seen))
    missions = xr.concat(rows, xr.DataArray(list(flights), dims="mission", name="mission"), join="outer")
    data = missions.assign(share=share)
    return Findings(
        "Where an engine's loss can be landed",
        data,
        _summary(asked, data),
        flights=flights,
        files=[find("perturbation", "robot"), *files.values()],
    )


def _summary(asked: LandingMap, data: xr.Dataset) -> dict[str, dict[str, float]]:
    """Return shares of the map by height, and how long each engine's loss is outside on each mission."""
    shares: dict[str, dict[str, float]] = {}
    for engine, (phase, lean) in itertools.product(asked.engines, zip(PHASES, data["lean"].values, strict=True)):
        for speed in asked.speeds if lean else data["speed"].values:
            cell = data["share"].sel(engine=engine, lean=lean, speed=speed)
            name = f"{engine}, {phase} at {speed:g} m/s" if speed else f"{engine}, hover"
            shares[name] = {f"{height:g} m [%]": 100.0 * float(cell.sel(height=height)) for height in asked.heights}
    for mission, engine in itertools.product(data["mission"].values, asked.engines):
        one = data.sel(mission=mission, engine=engine)
        shares[f"{mission}, {engine}"] = {
            "in the air [s]": float(one["aloft"]),
            "outside by the map [s]": SAMPLE * int((one["map"] < asked.share).sum()),
            "outside as flown [s]": asked.every * int((one["flown"] < asked.share).sum()),
            "land at any time [%]": 100.0 * float(one["flown"].mean()),
            "least share by the map [%]": 100.0 * float(one["map"].min()),
        }
    return shares


STUDY = Study("landing_map", __doc__, LandingMap, compute, ("robot",), backend="rust")
main = STUDY.main
