"""Failures of flights by the crate, and of its controller tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.control.modes import MODES

Row = dict[str, Any]
EXACT, SENSORS = "test2_observer", "test2_sensors"
BASE = ("base_position", "base_rotation", "base_velocity")
ARMS, CHEST = ("l_arm_jet", "r_arm_jet"), ("chest_l_jet", "chest_r_jet")
SHARES = (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3)
ERRORS = (90.0, 40.0, 20.0, -20.0, -40.0, -90.0)
"""Errors of a thrust sensor [N]."""
JERK = 6.0 * np.repeat([0.0, 1.0, -1.0, 1.0, 0.0], [500, 40, 80, 40, 740])
"""Jerk of a climb, tick by tick [m/s³]: up from 5 s on."""


@dataclass(frozen=True)
class Failure:
    """A flight with a failure."""

    case: str
    experiment: str
    since: float
    """Time of the failure [s]."""
    changes: Mapping[str, Any]
    controller: Mapping[str, Any] | None = None
    """Controller in place of the experiment's."""

    def config(self) -> rust.Config:
        """Return the configuration of the flight."""
        config = rust.load_config(self.experiment, self.changes)
        return config if self.controller is None else config | {"controller": self.controller}


def fly(failures: Iterable[Failure], every: int) -> Iterator[tuple[Failure, rust.FlightResult]]:
    """Fly every so-manieth failure."""
    chosen = list(islice(failures, 0, None, every))
    yield from zip(chosen, rust.fly_batch([one.config() for one in chosen], full_log=True), strict=True)


def judge(failure: Failure, flight: rust.FlightResult) -> Row:
    """Return whether a flight completes, how far it leans, and when the failure is detected."""
    after = flight["time"] >= failure.since
    found = np.flatnonzero(after & (flight["degraded_modes"] > 0))
    return {
        "case": failure.case,
        "completed": flight.outcome == "completed",
        "lean": float(np.degrees(flight["rotation_error"][after].max(initial=0.0))),
        "found": float(flight["time"][found[0]] - failure.since) if found.size else np.nan,
    }


def _seeds(experiment: str, seeds: Sequence[int]) -> list[dict[str, Any]]:
    return [{"simulator.sensors.seed": seed} for seed in seeds] if experiment == SENSORS else [{}]


def losses(every: int) -> list[Row]:
    """Lose the base at a time of TEST2; the set-point brakes, or stops at once."""

    def failures() -> Iterator[Failure]:
        for channel, experiment, brakes in product(BASE, (EXACT, SENSORS), (1.5, 1e3)):
            case = f"{channel}, {experiment}, {'brakes' if brakes < 10 else 'stops at once'}"
            for since, speed, seed in product(
                (18.0, 26.0, 28.0, 31.0), (0.0, 5.0, 10.0), _seeds(experiment, range(1, 4))
            ):
                changes = {
                    "simulator.duration": since + 12.0,
                    "wind": {"profile": "constant", "velocity": [0.0, -speed, 0.0]},
                    "controller.setpoint.deceleration": brakes,
                    "disturbances.outages": [{"channel": channel, "start": since, "kind": "missing"}],
                }
                yield Failure(case, experiment, since, changes | seed)

    return [judge(*flown) for flown in fly(failures(), every)]


def planned(every: int) -> list[Row]:
    """Lose the base at a time of the planned missions."""

    def failures() -> Iterator[Failure]:
        controller = rust.load_config(EXACT)["controller"]
        for mission, channel in product(("min_time", "min_fuel"), BASE):
            for since in (8, 8.5, 9, 9.5, 10, 10.5, 11, 12, 13, 14, 14.5, 15, 15.5, 16, 16.5, 17):
                lost = {"channel": channel, "start": float(since), "kind": "missing"}
                changes = {"simulator.duration": since + 13.0, "disturbances.outages": [lost]}
                yield Failure(f"{mission}, {channel}", mission, since, changes, controller)

    return [judge(*flown) for flown in fly(failures(), every)]


def _thrust(experiment: str, since: float, faults: Iterable[Mapping[str, Any]], seeds: Sequence[int]) -> Any:
    for fault, jet, seed in product(faults, (*ARMS, *CHEST), _seeds(experiment, seeds)):
        case = f"{experiment}, {'arm' if jet in ARMS else 'chest'}, {fault.get('error', fault['kind'])}"
        outage = {"channel": "thrust", "jet": jet, "start": since, **fault}
        yield Failure(
            case, experiment, since, {"simulator.duration": since + 4.0, "disturbances.outages": [outage]} | seed
        )


def thrust(every: int) -> list[Row]:
    """Measure one thrust of TEST2 wrong or frozen from 18 s on, hovering."""
    wrong = [{"kind": "wrong", "error": error} for error in ERRORS]
    failures = [*_thrust(EXACT, 18.0, [*wrong, {"kind": "frozen"}], ()), *_thrust(SENSORS, 18.0, wrong, (1,))]
    return [judge(*flown) for flown in fly(failures, every)]


def thrust_checked(every: int) -> list[Row]:
    """Do the same at times and with seeds that were not used to choose the limits."""

    def failures() -> Iterator[Failure]:
        wrong = [{"kind": "wrong", "error": error} for error in ERRORS]
        for since in (12.0, 18.0, 20.0, 26.0):
            yield from _thrust(EXACT, since, wrong, ())
        for since in (12.0, 20.0):
            yield from _thrust(SENSORS, since, wrong, range(11, 15))

    held = MODES["thrust_modelled"]
    return [judge(*flown) | {"held": bool(flown[1]["degraded_modes"][-1] == held)} for flown in fly(failures(), every)]


def thrust_scaled(every: int) -> list[Row]:
    """Measure all thrusts of TEST2 wrong by a share, growing from 5 to 10 s or from the start."""

    def lean(share: float, since: float) -> float:
        config = rust.load_config(EXACT)
        controller, plant = rust.Controller(config), rust.Plant(config)
        seen, error = plant.measure(), 0.0
        while seen.time < config["simulator"]["duration"] and error < 90.0:
            scale = 1.0 + share * np.clip((seen.time - since) / 5.0, 0.0, 1.0)
            tick = controller.tick(seen.state, scale * np.asarray(seen.thrust), seen.wind, seen.time)
            turned = np.trace(np.asarray(tick.setpoint.rotation).T @ seen.state.base_rotation)
            error = max(error, float(np.degrees(np.arccos(np.clip((turned - 1.0) / 2.0, -1.0, 1.0)))))
            seen = plant.step(tick.thrust_rate, tick.joint_torque)
        return error

    rows = []
    for share, since in islice(product(SHARES, (5.0, -5.0)), 0, None, every):
        found = lean(share, since)
        case = f"{share:+.0%}, {'growing in 5 s' if since > 0 else 'from the start'}"
        rows.append({"case": case, "completed": found < 90.0, "lean": found})
    return rows


def engines(every: int) -> list[Row]:
    """Let an engine fade, get stuck or stop at once, with realistic sensors, until ten seconds after."""

    def failures() -> Iterator[Failure]:
        for (kind, decay), jets, since in product(
            (("off", 0.5), ("stuck", 0.0), ("off", 0.0)), (ARMS, CHEST), (18.0, 28.0)
        ):
            what = "fades" if decay else {"off": "stops at once", "stuck": "is stuck"}[kind]
            case = f"{'arm' if jets is ARMS else 'chest'} jet {what} at {since:g} s"
            for jet, seed in product(jets, _seeds(SENSORS, range(1, 5))):
                lost = {"jet": jet, "time": since, "kind": kind, "decay": decay}
                changes = {"simulator.duration": since + 10.0, "disturbances.jets.failure": lost}
                yield Failure(case, SENSORS, since, changes | seed)

    return [
        judge(failure, flight) | {"sink": float(-flight["com_velocity"][-1, 2])}
        for failure, flight in fly(failures(), every)
    ]


def descent(every: int) -> list[Row]:
    """Let an engine fade or stop at once, and fly on beyond 90 deg down to the height of the start."""

    def failures() -> Iterator[Failure]:
        unmonitored = rust.load_config(EXACT, {"controller.engines.deviation_max": 1e6})["controller"]
        for watched, decay, jets, since in product((True, False), (0.5, 0.0), (ARMS, CHEST), (18.0, 28.0)):
            what = "fades" if decay else "stops at once"
            case = (
                f"{'arm' if jets is ARMS else 'chest'} jet {what} at {since:g} s{'' if watched else ', not monitored'}"
            )
            for jet in jets:
                lost = {"jet": jet, "time": since, "kind": "off", "decay": decay}
                falls = {"rotation_error_deg": 180.0, "com_error": 1000.0}
                changes = {"disturbances.jets.failure": lost, "simulator.fall": falls}
                yield Failure(case, EXACT, since, changes, None if watched else unmonitored)

    rows = []
    for failure, flight in fly(failures(), every):
        since, height = flight["time"] - failure.since, flight["com_position"][:, 2]
        is_down = (since > 0.0) & (height < height[0])
        # A flight that never comes down is judged to its end.
        ground = int(np.argmax(is_down)) if is_down.any() else len(height) - 1
        until = slice(None, ground + 1)
        found = np.flatnonzero(flight["degraded_modes"].astype(int) & MODES["engine_limited"])
        rows.append(
            {
                "case": failure.case,
                "completed": bool(is_down.any()),
                "lean": float(np.degrees(flight["rotation_error"][until].max())),
                "found": float(since[found[0]]) if found.size else np.nan,
                "down": float(since[ground]) if is_down.any() else np.nan,
                "sink": float(-flight["com_velocity"][ground, 2]),
            }
        )
    return rows


def pauses(every: int) -> list[Row]:
    """Pause the controller during a climb; its last command acts."""
    rows = []
    ticks = (5, 12, 18, 20, 22, 24, 30)
    starts = (540, 550, 560, 570, 580, 800)
    for experiment, pause, start in islice(product((EXACT, SENSORS), ticks, starts), 0, None, every):
        distance = greatest_distance(experiment, start, pause)
        rows.append({"case": f"{experiment}, {10 * pause} ms", "completed": distance < 1.0, "distance": distance})
    return rows


def greatest_distance(experiment: str, start: int, pause: int) -> float:
    """Return the greatest distance of the centre of mass from its set-point [m], with a pause of so many ticks."""
    config = rust.load_config(experiment, {"wind": {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}})
    controller, plant = rust.Controller(config), rust.Plant(config)
    step = config["simulator"]["time_step"]
    acceleration = step * np.cumsum(JERK)
    velocity = step * np.cumsum(acceleration)
    climb = np.array([step * np.cumsum(velocity), velocity, acceleration, JERK]).T
    seen, along, greatest = plant.measure(), None, 0.0
    tick = controller.tick(seen.state, seen.thrust, seen.wind, seen.time)
    first = tick.setpoint
    for k, up in enumerate(climb):
        if k > 0 and not start < k < start + pause:
            tick = controller.tick(seen.state, seen.thrust, seen.wind, seen.time, setpoint=along)
            off = np.asarray(tick.com_position) - np.asarray(tick.setpoint.com_position)
            greatest = max(greatest, float(np.linalg.norm(off)))
        position, *rates = np.outer(up, [0.0, 0.0, 1.0])
        along = replace(
            first,
            com_position=np.asarray(first.com_position) + position,
            com_velocity=rates[0],
            com_acceleration=rates[1],
            com_jerk=rates[2],
        )
        seen = plant.step(tick.thrust_rate, tick.joint_torque)
    return greatest


PARTS: Mapping[str, Callable[[int], list[Row]]] = {
    part.__name__: part for part in (losses, planned, thrust, thrust_checked, thrust_scaled, engines, descent, pauses)
}
