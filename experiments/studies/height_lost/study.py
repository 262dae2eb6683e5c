"""Least height that a robot loses after one of its engines stops, its gentlest touchdown, and its fastest descent.

`jax-aero study height_lost` begins with the state of a robot's flight when an engine stops. For a while nothing reacts.
Then the throttles of the others (M32) and joints of limited velocity are free, in the centroidal dynamics. A fall from
hover that loses the least height ends in a state in which the robot may touch down and go on: slow and level, without
turning, moments balanced, and no longer falling faster. Engines that are faster or stronger show what either is worth.
The gentlest touchdown is on ground where the flight began, from low hovers and on the way of the mission. The fastest
descent is the one from which a touchdown within the limits of a landing still exists, by height. Each is a local
optimum, and beside each stands what flights do. The results go to `results/height_lost/hover/`, `touchdown/` and
`sink/`.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from experiments.studies.height_lost import sink
from experiments.studies.height_lost.fall import (
    DOWNWARDS_MAX,
    LEAN_MAX,
    LONGEST,
    SIDEWAYS_MAX,
    UNITS,
    Array,
    Fall,
    HeightLost,
    Landing,
    Touchdown,
    flight_of,
)
from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.results.study import Findings, Study

ABOVE = 30.0
"""Height that is added to the flights [m]."""
START, SETTLING = 10.0, 3.0
"""When a climb to a hover begins, after the wind's rise, and the time after it until an engine stops [s]."""


def flown(asked: HeightLost, config: rust.Config, engine: str) -> Landing:
    """Return the end of a flight's fall: within the limits of a landing from then on, for 10 s after the loss."""
    initial = config["simulator"]["initial"]
    x, y, z = initial["base_position"]
    higher = flight_of(config, asked.time + 10.0, initial={**initial, "base_position": [x, y, z + ABOVE]})
    log = rust.fly(_failing(higher, engine, asked.time)).log
    after = log["time"] >= asked.time
    velocity, lean = log["com_velocity"][after], _lean(log)[after]
    sideways = np.linalg.norm(velocity[:, :2], axis=1)
    beyond = (-velocity[:, 2] > DOWNWARDS_MAX) | (sideways > SIDEWAYS_MAX) | (lean > np.degrees(LEAN_MAX))
    last = int(np.flatnonzero(beyond)[-1]) if beyond.any() else 0
    if last + 1 >= beyond.size:
        return Landing()
    height, time = log["com_position"][after][:, 2], log["time"][after]
    return Landing(height[0] - height[last], time[last] - time[0], -velocity[:, 2].min(), lean.max())


def touched(config: rust.Config, engine: str, time: float) -> Touchdown:
    """Return the touchdown of a flight after a loss."""
    flight = rust.fly(_failing(flight_of(config, time + 2.0 * LONGEST), engine, time))
    if flight.outcome not in ("landed", "crashed"):
        return Touchdown()
    velocity, lean = flight.log["com_velocity"][-1], _lean(flight.log)[flight.log["time"] >= time]
    sideways, duration = np.linalg.norm(velocity[:2]), flight.log["time"][-1] - time
    return Touchdown(*map(float, (-velocity[2], sideways, lean[-1], duration, lean.max())))


def losses_of(asked: HeightLost, config: rust.Config) -> dict[str, tuple[rust.Config, float]]:
    """Return flights and times of their losses [s] by name: hovers, each after a climb, and moments of the mission."""
    tops = {height: START + height / config["controller"]["setpoint"]["speed"][1] for height in asked.hovers}
    hovers = {
        f"hover at {height:g} m": ({**config, "mission": {"up": [[START, top]]}}, top + SETTLING)
        for height, top in tops.items()
    }
    return hovers | {f"mission at {time:g} s": (config, time) for time in asked.moments}


def _failing(config: rust.Config, engine: str, time: float) -> rust.Config:
    return {**config, "disturbances": {"jets": {"failure": {"jet": engine, "time": time, "kind": "off"}}}}


def _lean(log: Mapping[str, Array]) -> Array:
    """Return the lean [deg] of each tick."""
    up = rust.rotation_from_wxyz(log["base_quaternion"])[:, 2, 2]
    return np.asarray(np.degrees(np.arccos(np.clip(up, -1.0, 1.0))))


def landings(asked: HeightLost, config: rust.Config, engine: str) -> tuple[float, list[Landing]]:
    """Return the greatest acceleration at the end [m/s²], and all falls, those with other engines from the first."""
    fall, guess = Fall(asked, config, asked.time, engine), None
    falls = []
    for scales in asked.others:
        landing, unknowns = fall.solve(*scales, guess)
        guess = unknowns if guess is None else guess
        falls.append(landing)
    return fall.greatest_acceleration(1.0), [*falls, flown(asked, config, engine)]


def heights(asked: HeightLost, flights: Mapping[str, rust.Config]) -> Findings:
    """Compute the falls from hover, and fly."""
    rows = [landings(asked, config, engine) for config, engine in product(flights.values(), asked.engines)]
    dims, shape = ("robot", "engine"), (len(flights), len(asked.engines))
    values = np.array([row for _, row in rows]).reshape(*shape, len(asked.others) + 1, len(Landing._fields))
    best = np.reshape([acceleration for acceleration, _ in rows], shape)
    variables: dict[str, Any] = {"acceleration": (dims, best, {"units": "m s-2"})}
    for place, (field, unit) in enumerate(UNITS[Landing].items()):
        variables[field] = ((*dims, "others"), values[:, :, :-1, place], {"units": unit})
        variables[f"flown_{field}"] = (dims, values[:, :, -1, place], {"units": unit})
    for place, name in enumerate(("spool_up", "thrust")):
        variables[name] = ("others", [scales[place] for scales in asked.others], {"units": "1"})
    data = xr.Dataset(variables, {"robot": list(flights), "engine": list(asked.engines)})
    numbers: dict[str, float] = {}
    for robot, engine in product(data["robot"].values, data["engine"].values):
        name, one = f"{robot}, {engine}", data.sel(robot=robot, engine=engine)
        numbers[f"{name}: greatest acceleration at the end [m/s2]"] = float(one["acceleration"])
        for field, unit in UNITS[Landing].items():
            for of in one["others"].values:
                scales = f"spool-up {float(one['spool_up'][of]):g}, thrust {float(one['thrust'][of]):g}"
                numbers[f"{name}, {scales}: {field} [{unit}]"] = float(one[field][of])
            numbers[f"{name}, flown: {field} [{unit}]"] = float(one[f"flown_{field}"])
    return Findings("Least height lost after an engine stops", data, _numbers(numbers), flights=flights)


def touchdowns(asked: HeightLost, flights: Mapping[str, rust.Config]) -> Findings:
    """Compute the gentlest touchdowns, and fly."""
    gentlest, labels = {}, list(losses_of(asked, next(iter(flights.values()))))
    for (robot, config), engine in product(flights.items(), asked.engines):
        for place, (flight, time) in losses_of(asked, config).items():
            best = Fall(asked, flight, time, engine).touch_down()
            gentlest[robot, engine, place] = best, touched(flight, engine, time)
            print(robot, engine, place, *gentlest[robot, engine, place], flush=True)
    axes = {"robot": list(flights), "engine": list(asked.engines), "place": labels, "of": ["optimum", "flown"]}
    values = np.array(list(gentlest.values())).reshape(*map(len, axes.values()), len(Touchdown._fields))
    data = xr.Dataset(
        {
            field: (tuple(axes), values[..., place], {"units": unit})
            for place, (field, unit) in enumerate(UNITS[Touchdown].items())
        },
        axes,
    )
    summary = {
        f"{', '.join(of)}: {field}, {what} [{unit.replace(' s-1', '/s')}]": getattr(end, field)
        for of, ends in gentlest.items()
        for what, end in zip(axes["of"], ends, strict=True)
        for field, unit in UNITS[Touchdown].items()
    }
    return Findings("Gentlest touchdown after an engine stops", data, _numbers(summary), flights=flights)


def _numbers(figures: Mapping[str, float]) -> dict[str, float | None]:
    return {key: None if np.isnan(value) else value for key, value in figures.items()}


PARTS = {"hover": heights, "touchdown": touchdowns, "sink": sink.sinks}
"""What is computed, by the name of the result."""


def compute(name: str, asked: HeightLost) -> Findings:
    """Compute one part."""
    if name not in PARTS:
        raise Refused(f"there is no {name}; expected one of {', '.join(PARTS)}")
    return PARTS[name](asked, {one: rust.load_config(one) for one in asked.experiments})


STUDY = Study("height_lost", __doc__, HeightLost, compute, tuple(PARTS))
main = STUDY.main
