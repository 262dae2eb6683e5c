"""The published MPC of iRonCub-Mk3 beside our controllers, in still air, after pushes and in wind.

`jax-aero study published_mpc` flies the first 26 s of the published mission, with engines, by the controller of Gorbani
et al. 2025 (arXiv 2505.16478), written from its equations, and by ours, under equal perturbations of start and forces.
Flight r has wind or push from 45 r degrees. An interrupted study is resumed by the same command.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from experiments.studies.published_mpc import plan
from experiments.studies.published_mpc.flight import Published
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.terminal import Refused
from jax_aero.base.wind_direction import wind_from
from jax_aero.results.identity import Identity
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.perturbation import Perturbation

EXPERIMENT, PERTURBATION = "mk3_min_jerk", places.CONFIGS / "perturbation" / "flight.toml"
PUSHED = 6.0
"""Duration of a flight with a push on the chest, from 3 to 3.2 s [s]."""


class Case(NamedTuple):
    """What happens to the robot."""

    speed: float = 0.0
    """Of the wind [m/s]."""
    moment: float = 0.0
    """Of a push on the chest, while hovering [N m]."""


CASES = {
    "still air": Case(),
    "push of 50 N m": Case(moment=50.0),
    "push of 300 N m": Case(moment=300.0),
    "5 m/s": Case(speed=5.0),
    "10 m/s": Case(speed=10.0),
    "15 m/s": Case(speed=15.0),
    "20 m/s": Case(speed=20.0),
}
PUBLISHED = "published"
STIFF = {"controller.torque.kp": 2500.0, "controller.torque.kd": 100.0}
"""Joints of the published controller: 50 rad/s, critically damped [1/s², 1/s]."""
WITHOUT = {
    "controller.aero": {"model": "off"},
    "controller.disturbance_observer": False,
    "controller.fault_detection.engines": False,
}
OURS = {"observer": "mk3_min_jerk", "predictive law": "mk3_min_jerk_mpc"}
"""Experiments of our controllers."""


class Compared(tables.Table, frozen=True):
    """Flights to fly."""

    controllers: tuple[str, ...] = (PUBLISHED, *OURS)
    cases: tuple[str, ...] = tuple(CASES)
    flights: tables.Count = 40
    """Flights a case of the observer and the predictive law."""
    published_flights: tables.Count = 8
    """Flights a case of the published controller."""
    duration: tables.Positive = 26.0
    """[s]; a push takes 6 s."""

    def __post_init__(self) -> None:
        for key, known in (("controllers", (*OURS, PUBLISHED)), ("cases", CASES)):
            tables.check_levels(self, key)
            for name in getattr(self, key):
                if name not in known:
                    raise Refused(f"`{key}` has `{name}`{places.did_you_mean(name, known)}")


def compute(_: str, asked: Compared, work: Work) -> Findings:
    """Fly what is not flown yet, and make the table."""
    bases = {base: rust.load_config(base) for base in OURS.values()}
    work = work.narrowed(Identity.of({name: rust.config_digest(one) for name, one in bases.items()}, [PERTURBATION]))
    flown: dict[str, list[Any]] = {}
    for case, controller in product(asked.cases, asked.controllers):
        name = f"{controller} | {case}"
        flights = work.read_json(name)
        if flights is None:
            work.write_json(name, flights := fly_cell(controller, CASES[case], asked))
            print(f"  {name}", flush=True)
        flown[name] = flights
    rows = {name: figures(flights) for name, flights in flown.items()}
    most = max(map(len, flown.values()))
    data = xr.Dataset(
        {
            "completed": (("cell", "flight"), _padded(flown, 0, most), {"units": "1"}),
            "rotation_error": (("cell", "flight"), _padded(flown, 2, most), {"units": "deg"}),
            "com_error": (("cell", "flight"), _padded(flown, 3, most), {"units": "m"}),
        },
        {"cell": list(flown)},
    )
    inputs = {"cases": {name: case._asdict() for name, case in CASES.items()}}
    files = [PERTURBATION]
    return Findings("Published MPC and ours", data, rows, flights=bases, inputs=inputs, files=files)


STUDY = Study("published_mpc", __doc__, Compared, compute, ("mk3",), backend="rust", resumes=True)
main = STUDY.main


def configure(controller: str, case: Case, repeat: int, duration: float) -> rust.Config:
    """Return the perturbed configuration of a flight."""
    direction = 45.0 * (repeat % 8)
    settings: dict[str, Any] = {"simulator.duration": PUSHED if case.moment else duration}
    settings["wind.velocity"] = wind_from(case.speed, direction)
    if case.moment:
        push = {"body": "chest", "start": 3.0, "duration": 0.2, "moment": wind_from(case.moment, direction)}
        settings["disturbances.pushes"] = [push]
    if controller == PUBLISHED:
        settings["controller.time_step"] = plan.PERIOD  # with engines of its own
        settings |= WITHOUT | STIFF  # of the configuration's controller only set-point and these gains count
    else:
        settings["simulator.jets.dynamics"] = "throttled"
    config = rust.load_config(OURS.get(controller, EXPERIMENT), settings)
    tables.load(PERTURBATION, Perturbation).apply(config, 0, repeat, rust.Robot(config["robot"]))
    return rust.resolve_config(config)


def fly_cell(controller: str, case: Case, asked: Compared) -> list[tuple[int, str, float, float]]:
    """Return whether a flight completed, outcome, rotation error [deg] and CoM error [m] of the flights of a cell."""
    count = asked.published_flights if controller == PUBLISHED else asked.flights
    asked_for = [configure(controller, case, repeat, asked.duration) for repeat in range(count)]
    if controller in OURS:
        flown = rust.fly_batch(asked_for, 1)
    else:
        flown = [rust.Flight(config, controller=Published(config)).run() for config in asked_for]
    return [
        (
            int(one.outcome == "completed"),
            str(one.outcome),
            float(np.degrees(one.summary["max_rotation_error"])),
            one.summary["max_com_error"],
        )
        for one in flown
    ]


def figures(flights: list[Any]) -> dict[str, float]:
    """Return share and medians of the flights of a cell; errors of those that completed."""
    completed = [one for one in flights if one[0]]
    low, high = wilson(len(completed), len(flights))
    cell = {"completed": len(completed), "flights": len(flights), "low": low, "high": high}
    for at, name in ((2, "rotation_error_deg"), (3, "com_error_m")):
        values = [one[at] for one in completed]
        cell |= {name: float(np.median(values)), f"{name}_max": max(values)} if values else {}
    return cell


def _padded(flown: Mapping[str, list[Any]], at: int, most: int) -> Any:
    rows = [[float(one[at]) for one in flights] for flights in flown.values()]
    return np.array([one + [np.nan] * (most - len(one)) for one in rows])
