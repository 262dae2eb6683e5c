"""Failures of flights by the crate, and of its controller tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.base.result import UPRIGHT
from jax_aero.rust import MODES

Row = dict[str, Any]
EXACT, SENSORS = "test2_observer", "test2_sensors"
ARMS, CHEST = ("l_arm_jet", "r_arm_jet"), ("chest_l_jet", "chest_r_jet")
SHARES = (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3)
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


def thrust_scaled(every: int) -> list[Row]:
    """Measure all thrusts of TEST2 wrong by a share, growing from 5 to 10 s or from the start."""

    def fly_wrong(share: float, since: float) -> rust.FlightResult:
        flight = rust.Flight(rust.load_config(EXACT))
        while not flight.has_ended:
            seen = flight.measurement
            scale = 1.0 + share * np.clip((seen.time - since) / 5.0, 0.0, 1.0)
            flight.step(measurement=seen._replace(thrust=scale * seen.thrust))
        return flight.result()

    rows = []
    for share, since in islice(product(SHARES, (5.0, -5.0)), 0, None, every):
        flown = fly_wrong(share, since)
        case = f"{share:+.0%}, {'growing in 5 s' if since > 0 else 'from the start'}"
        lean = float(np.degrees(flown.summary["max_rotation_error"]))
        rows.append({"case": case, "completed": flown.outcome in UPRIGHT, "lean": lean})
    return rows


def descent(every: int) -> list[Row]:
    """Let an engine fade or stop at once, and fly on beyond 90 deg down to the height of the start."""

    def failures() -> Iterator[Failure]:
        unmonitored = rust.load_config(EXACT, {"controller.fault_detection.engines.deviation_max": 1e6})["controller"]
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
    anywhere = {"rotation_error_deg": 180.0, "com_error": 1000.0}
    still = {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}
    config = rust.load_config(experiment, {"wind": still, "simulator.fall": anywhere})
    controller, flight = rust.Controller(config), rust.Flight(config)
    step = config["controller"]["time_step"]
    acceleration = step * np.cumsum(JERK)
    velocity = step * np.cumsum(acceleration)
    climb = np.array([step * np.cumsum(velocity), velocity, acceleration, JERK]).T
    seen, along, greatest = flight.truth, None, 0.0
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
        flight.step(command=rust.Command(tick.thrust_rate, tick.joint_torque))
        seen = flight.truth
    return greatest


PARTS: Mapping[str, Callable[[int], list[Row]]] = {part.__name__: part for part in (thrust_scaled, descent, pauses)}
