"""Flights of designs in the realistic simulation, block by block."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from experiments.studies.design import robots
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.result import LOST
from jax_aero.results.work import Work
from jax_aero.sweep.keys import set_all
from jax_aero.sweep.perturbation import Perturbation

BASE, PERTURBATION = "mk3_robot", places.CONFIGS / "perturbation" / "robot.toml"
POSITION, ROTATION = 0.05, np.radians(3.0)
"""Errors of unit tracking [m, rad]."""
SETTLED = 1.0
"""Time from which tracking is judged [s]."""
Row = dict[str, Any]


def _turbulence(speed: float) -> Row:
    wind = {"profile": "turbulent", "velocity": [0.0, -speed, 0.0], "ramp_start": 0.0, "ramp_end": 1.0}
    return wind | {"std": [0.2 * speed, 0.2 * speed, 0.1 * speed], "time_scale": 2.0}


def _loss(up: float, fast: bool, wind: float, time: float, duration: float, jet: str = "l_arm_jet") -> Row:
    """Return a climb of 1.5 m/s until a time [s], a hover or the fast leg, and the loss of an engine in it."""
    return {
        "mission": {"up": [[0.1, up]]} | ({"forward_turbo": [[up, duration]]} if fast else {}),
        "controller.setpoint.speed": [0.75, 1.5],
        "wind": _turbulence(wind) if wind else {"profile": "constant", "velocity": [0.0, 0.0, 0.0]},
        "disturbances.jets.failure": {"jet": jet, "time": time, "kind": "off"},
        "simulator.duration": duration,
    }


FLIGHTS = {"still": _loss(1.1, False, 0.0, 2.2, 3.5), "fast": _loss(0.7, True, 15.0, 4.5, 5.5)}
"""Flights of every design, changes of `BASE`: a climb in still air, after which the left arm engine stops in hover; the
fast leg in turbulence of 15 m/s, where it stops too."""
HOVER = {"mission": {}, "wind": _turbulence(15.0), "simulator.duration": 12.0}
AGAIN = {
    "still": FLIGHTS["still"],
    "hover": HOVER,
    "hover, 20 m/s": HOVER | {"wind": _turbulence(20.0)},
    "hover, left arm": _loss(2.1, False, 15.0, 3.0, 6.0),
    "hover, right chest": _loss(2.1, False, 15.0, 3.0, 6.0, "chest_r_jet"),
    "fast, left arm": _loss(1.6, True, 15.0, 6.1, 7.6),
    "fast, right arm": _loss(1.6, True, 15.0, 6.1, 7.6, "r_arm_jet"),
    "fast, right chest": _loss(1.6, True, 15.0, 6.1, 7.6, "chest_r_jet"),
}
"""Flights of the chosen few: but for the first, in turbulence of 15 m/s."""
FIGURES = ("lost", "tracking", "com", "rotation", "thrust", "lean", "sink")


class Job(NamedTuple):
    """Designs (k, parameters) to fly, numbers of the draws of the world, changes of `BASE` by flight, and a seed."""

    designs: robots.Array
    draws: tuple[int, ...]
    flights: Mapping[str, Mapping[str, Any]]
    seed: int


def fly_block(job: Job) -> list[Row]:
    """Return a row per design: its trim, and the figures of its flights (draws, flights, figures)."""
    base, drawn, rows = rust.load_config(BASE), tables.load(PERTURBATION, Perturbation), []
    with TemporaryDirectory() as folder:
        for design in job.designs:
            path = robots.write(dict(zip(robots.RANGES, design.tolist(), strict=True)), Path(folder))
            (trim, config), robot = robots.fit(path, base), rust.Robot(path)
            figures = np.full((len(job.draws), len(job.flights), len(FIGURES)), np.nan)
            for at, draw in enumerate(job.draws if config else ()):
                flown = [set_all(config, changes) for changes in job.flights.values()]
                for one in flown:
                    drawn.apply(one, job.seed, draw, robot)
                flights = rust.fly_batch(flown, threads=1, full_log=True)
                figures[at] = [judge(*pair) for pair in zip(flown, flights, strict=True)]
            row = {"missed": trim.missed, "pitch": float(np.degrees(trim.base_rpy[1])), "mass": robot.mass}
            rows.append(row | {"figures": figures.tolist()})
    return rows


def judge(config: rust.Config, flown: rust.FlightResult) -> list[float]:
    """Return the `FIGURES` of a flight.

    Whether it was lost; root of the mean cost of tracking, position [m] and rotation error [rad] (rms) and mean total
    thrust [N], from `SETTLED` until an engine stops; then the greatest rotation error [deg] and sinking speed [m/s].
    """
    failure, time = config.get("disturbances", {}).get("jets", {}).get("failure"), flown["time"]
    stop = failure["time"] if failure else np.inf
    before, after = (time >= SETTLED) & (time < stop), time >= stop
    lost = float(flown.outcome in LOST)
    if not before.any() or (lost and failure and not after.any()):
        return [1.0, *[np.nan] * (len(FIGURES) - 1)]
    position, rotation = flown["com_position"] - flown["com_setpoint"], flown["rotation_error"]
    squares = (position[before] ** 2).sum(axis=1).mean(), (rotation[before] ** 2).mean()
    tracking, thrust = squares[0] / POSITION**2 + squares[1] / ROTATION**2, flown["thrust"][before].sum(axis=1).mean()
    lean = np.degrees(rotation[after].max(initial=0.0)) if failure else np.nan
    sink = -flown["com_velocity"][after, 2].min(initial=0.0) if failure else np.nan
    return [lost, *np.sqrt([tracking, *squares]), thrust, lean, sink]


def fly(jobs: Mapping[int, Job], work: Work, processes: int) -> dict[int, list[Row]]:
    """Return the rows of blocks; finished ones are not flown."""
    done: dict[int, list[Row]] = {number: rows for number in jobs if (rows := work.read_json(str(number))) is not None}
    left = {number: job for number, job in jobs.items() if number not in done}
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for number, rows in pool.imap_unordered(_numbered, left.items()):
            work.write_json(str(number), rows)
            done[number] = rows
            print(f"\r{len(done)} of {len(jobs)} blocks", end="", file=sys.stderr, flush=True)
    return {number: done[number] for number in jobs}


def _numbered(item: tuple[int, Job]) -> tuple[int, list[Row]]:
    return item[0], fly_block(item[1])
