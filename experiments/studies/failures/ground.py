"""Failures of the flight from the ground to the ground, which MuJoCo simulates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import islice, product

import numpy as np

from experiments.studies.failures.flights import ARMS, CHEST, Row
from jax_aero import rust
from jax_aero.base.result import UPRIGHT
from jax_aero.mujoco import ground
from jax_aero.rust import MODES

DURATION = 24.0
"""Duration of a flight [s]."""
STILL = (0.0, 0.0, 0.0)
WINDS = (
    STILL,
    (0.0, -5.0, 0.0),
    (-5.0, 0.0, 0.0),
    (5.0, 5.0, 0.0),
    (7.0, 0.0, 0.0),
    (0.0, 8.0, 0.0),
    (0.0, -10.0, 0.0),
)
TIMES = (0.2, 1.0, 2.5, 3.0, 3.4, 3.6, 4.0, 6.0, 9.0, 11.7, 11.85, 12.1, 13.0, 14.0, 18.0)


Change = Callable[[rust.Measurement], rust.Measurement]
"""What becomes of a measurement on its way to the controller."""


def take_off(
    wind: tuple[float, ...] | None, *, change: Change | None = None, engine: tuple[str, float] | None = None
) -> rust.FlightResult:
    """Fly from the ground to the ground, in the experiment's own wind if `wind` is `None`.

    `engine` is a jet that stops and its time [s].
    """
    changes: dict[str, object] = {"simulator.duration": DURATION}
    if wind is not None:
        changes["wind.velocity"] = list(wind)
    if engine is not None:
        jet, time = engine
        changes["disturbances.jets.failure"] = {"jet": jet, "time": time, "kind": "off", "decay": 0.0}
    flight = ground.begin(rust.load_config("take_off", changes))
    while not flight.has_ended:
        flight.step(measurement=None if change is None else change(flight.measurement))
    return flight.result()


def _row(case: str, flight: rust.FlightResult) -> Row:
    modes = flight["degraded_modes"].astype(int)
    return {
        "case": case,
        "completed": flight.outcome in UPRIGHT,
        "feet": bool((modes & MODES["feet_predicted"]).any()),
    }


def take_off_base(every: int) -> list[Row]:
    """Lose foot sensors or base at a time of take_off, or measure them wrong."""
    flights = [
        *product(["foot_wrenches"], WINDS, (1.0, 3.0, 6.0, 9.0, 11.85, 12.1)),
        *product(["base_position", "base_rotation", "velocity"], WINDS[:2], TIMES),
        *product(["right"], WINDS, [0.0]),
        *product(["frozen", "zero"], WINDS[:2], TIMES),
    ]
    return [
        _row(what, take_off(wind, change=mislead(what, start))) for what, wind, start in islice(flights, 0, None, every)
    ]


def mislead(what: str, start: float) -> Change:
    """Return the change of a measurement that is lost or wrong from a time on."""
    last = [np.zeros((0, 6))]

    def change(seen: rust.Measurement) -> rust.Measurement:
        feet = seen.foot_wrenches
        if seen.time < start or what == "right":
            last[0] = feet
            return seen
        if what in ("foot_wrenches", "frozen", "zero"):
            wrong = {"foot_wrenches": np.nan * feet, "frozen": last[0], "zero": 0.0 * feet}
            return seen._replace(foot_wrenches=wrong[what])
        lost = np.array(getattr(seen.state, what))
        lost[:6] = np.nan  # of the velocity that of the base
        return seen._replace(state=seen.state._replace(**{what: lost}))

    return change


def take_off_engines(every: int) -> list[Row]:
    """Stop an engine of take_off before lift-off, which is at 3.8 s."""
    flights = islice(product((*ARMS, *CHEST), (0.5, 1.0, 1.5, 2.0, 2.5, 2.75, 3.0, 4.0)), 0, None, every)
    return [_row(f"stops at {time:g} s", take_off(None, engine=(jet, time))) for jet, time in flights]


def take_off_scaled(every: int) -> list[Row]:
    """Measure all thrusts of take_off wrong by a share."""

    def scale(share: float) -> Change:
        return lambda seen: seen._replace(thrust=(1.0 + share) * seen.thrust)

    flights = islice(product((-0.2, -0.15, -0.1, -0.05, 0.05, 0.1, 0.15, 0.2), WINDS[:2]), 0, None, every)
    return [_row(f"{share:+.0%}", take_off(wind, change=scale(share))) for share, wind in flights]


PARTS: Mapping[str, Callable[[int], list[Row]]] = {
    part.__name__: part for part in (take_off_base, take_off_engines, take_off_scaled)
}
