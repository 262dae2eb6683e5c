"""From which speed downwards an engine's loss can be landed, by height: by optimal control, and by flights."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import xarray as xr

from experiments.studies.height_lost.fall import (
    DOWNWARDS,
    DOWNWARDS_MAX,
    HEIGHT,
    LEAN_MAX,
    LONGEST,
    SIDEWAYS_MAX,
    Array,
    Fall,
    HeightLost,
    solved,
)
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.results.study import Findings, find
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.symbolic import load_robot
from jax_aero.symbolic.trajectory import IPOPT, fuel_burnt, fuel_lines, load_fuel

START, LOSS = 3.0, 6.0
"""When the robot begins to sink, and when the engine stops [s]: it then sinks steadily."""
LAG = 1.5 * 84.981 / 150.766
"""Time by which a steadily moving set-point follows the raw one [s], T̄ b/a of M45."""
WIND = {"wind.ramp_start": 0.0, "wind.ramp_end": 1.0}
"""The wind of the flight is there when the robot begins to sink."""
AFTER = 10.0
"""Duration of a flight after the loss [s], and the time of a descent from its height."""
NEAR = 0.05
"""Height above the start at which a mission ends [m]."""
RISING = 2.0
"""Greatest speed upwards of the optimum [m/s]."""
OF = ("optimum", "flown")


class Sink(Fall):
    """The fastest descent of a robot, hovering but for it, from which it can still touch down after a loss."""

    @cached_property
    def _fastest(self) -> tuple[Any, Array, Array]:
        """The search for its speed w, and the limits of its rows: `max w`, `x_0 = x_r − w (e_v + t_r e_z)`.

        x_r is the state of the hover after the time t_r without reaction, of which a descent at w changes height and
        speed alone: against the wind it is small.
        """
        x, u, duration, scales, _, defects, effort = self.path
        sink, drop, end = ca.MX.sym("sink"), ca.MX.sym("drop"), x[:, -1]
        moved = np.zeros(self.size)
        moved[[HEIGHT, DOWNWARDS]] = self.asked.reaction, 1.0
        ground = self.height - drop
        equal = ca.vertcat(defects, x[:, 0] - self.start + sink * moved, end[HEIGHT] - ground)
        lean = np.cos(LEAN_MAX) - self.upright(end)
        beyond = ca.vertcat(-end[DOWNWARDS] - DOWNWARDS_MAX, ca.sumsqr(end[3:5]) - SIDEWAYS_MAX**2, lean)
        rows = ca.vertcat(equal, beyond, ground - x[HEIGHT, :].T)
        problem = {"x": ca.veccat(x, u, duration, sink), "p": ca.vertcat(scales, drop), "f": effort - sink, "g": rows}
        zero = np.zeros(rows.numel())
        lower = np.where(np.arange(zero.size) < equal.numel(), 0.0, -np.inf)
        return ca.nlpsol("sink", "ipopt", problem, IPOPT), lower, zero

    def fastest(self, height: float) -> float:
        """Return it [m/s] for a loss at a height [m]; negative if the robot has to rise, NaN where none is found."""
        count, free = self.asked.intervals, np.full(self.size, np.inf)
        ends = zip((-free, free), (self.lower, self.upper), self.inputs, ((0.1, -RISING), (LONGEST, 9.0)), strict=True)
        low, high = (np.concatenate([first, *[on] * count, *[u] * (count + 1), last]) for first, on, u, last in ends)
        guess = np.append(self.guess(self.upper, height), 0.3)
        answer = solved(self._fastest, guess, [1.0, 1.0, height], low, high)
        return np.nan if answer is None else float(answer[0][-1])


def sinking(config: rust.Config, engine: str, height: float, speed: float) -> rust.Config:
    """Return a flight that sinks at a speed [m/s] and loses an engine at a height [m], which it measures."""
    forward, _ = config["controller"]["setpoint"]["speed"]
    return rust.set_keys(
        config,
        {
            "mission": {"down": [[START, LOSS + 1.0]]},
            "controller.setpoint.speed": [forward, speed],
            "simulator.duration": LOSS + AFTER + height / config["controller"]["setpoint"]["descent_speed"],
            "simulator.ground_height": -(height + speed * (LOSS - START - LAG)),
            "simulator.sensors.height": {"period": 0.05},
            "disturbances.jets.failure": {"jet": engine, "time": LOSS, "kind": "off"},
            **WIND,
        },
    )


def flown(asked: HeightLost, config: rust.Config, engine: str, height: float) -> float:
    """Return the fastest descent from which all robots land [m/s], by bisection; NaN if not even a hover is landed."""
    robot, widths = rust.Robot(config["robot"]), tables.load(find("perturbation", "robot"), Perturbation)

    def land(speed: float) -> bool:
        drawn = [copy.deepcopy(sinking(config, engine, height, speed)) for _ in range(asked.robots)]
        for repeat, one in enumerate(drawn):
            widths.apply(one, asked.seed, repeat, robot)
        return all(flight.outcome == "landed" for flight in rust.fly_batch(drawn))

    if not land(0.0):
        return np.nan
    low, high = 0.0, asked.speed_max
    for _ in range(asked.halvings):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if land(middle) else (low, middle)
    return low


def landing(config: rust.Config) -> xr.Dataset:
    """Return height [m] and speed downwards [m/s] of the raw set-point of a landing, `mission.land`, over its ticks."""
    mission = {"up": [[0.0, 6.0]], "land": [[6.0, 30.0]]}
    way = rust.set_keys(config, {"mission": mission, "simulator.duration": 18.0})
    raw = rust.setpoint_trajectory(way, np.zeros(3), np.eye(3))["raw_position"][:, 2]
    height, speed = raw[:-1], -np.diff(raw) / config["controller"]["time_step"]
    sinks = speed > 0.0
    return xr.Dataset({"landing_height": ("tick", height[sinks]), "landing_speed": ("tick", speed[sinks])})


def price(config: rust.Config, slow: rust.Config) -> dict[str, float]:
    """Return what a slow landing costs beside a mission's descent: seconds and litres, until it is near its start."""
    idle, slope = fuel_lines(load_fuel(places.CONFIGS / "tables" / "fuel.toml"), load_robot(config["robot"]))
    costs = []
    for flight in (config, slow):
        log = rust.fly(flight).log
        height = log["com_position"][:, 2] - log["com_position"][0, 2]
        end = int(np.flatnonzero(height > NEAR)[-1])
        costs.append((log["time"][end], fuel_burnt(log["time"], log["thrust"], idle, slope)[end]))
    seconds, litres = (float(later - sooner) for sooner, later in zip(*costs, strict=True))
    return {"longer [s]": seconds, "more fuel [l]": litres, "of the mission's [%]": 100.0 * litres / float(costs[0][1])}


def sinks(asked: HeightLost, flights: Mapping[str, rust.Config]) -> Findings:
    """Search both speeds for the first of the flights, for every engine and height."""
    experiment, config = next(iter(flights.items()))
    hover = rust.set_keys(config, {"mission": {}, **WIND})
    rows = []
    for engine in asked.engines:
        sink = Sink(asked, hover, LOSS, engine)
        for height in asked.sinking:
            rows.append((sink.fastest(height), flown(asked, config, engine, height)))
            print(engine, f"{height:g} m: optimum {rows[-1][0]:.2f} m/s, flown {rows[-1][1]:.2f} m/s", flush=True)
    axes: dict[str, Any] = {"engine": list(asked.engines), "height": list(asked.sinking), "of": list(OF)}
    values = np.reshape(rows, [len(of) for of in axes.values()])
    data = xr.Dataset({"speed": (tuple(axes), values, {"units": "m s-1"})}, axes)
    data["height"].attrs["units"] = "m"
    data = data.merge(landing(config))
    summary: dict[str, dict[str, float | None]] = {}
    for engine, of in itertools.product(asked.engines, OF):
        speeds = data["speed"].sel(engine=engine, of=of).values
        found = {f"{height:g} m [m/s]": float(speed) for height, speed in zip(asked.sinking, speeds, strict=True)}
        summary[f"{engine}, {of}"] = {key: None if np.isnan(speed) else speed for key, speed in found.items()}
    land = tables.read(places.CONFIGS / "mission" / "landing.toml")["land"]
    slow = rust.load_config(experiment, {"mission.down": [], "mission.land": land, "simulator.duration": 60.0})
    summary["a landing"] = {**price(config, slow)}
    return Findings(
        "Fastest descent from which an engine's loss is landed",
        data,
        summary,
        flights={experiment: config},
        files=[find("perturbation", "robot")],
    )
