"""Failures of the flight from the ground to the ground, which MuJoCo simulates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import islice, product
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiments.studies.failures.flights import Row
from jax_aero import mujoco_ground, rust
from jax_aero.control.modes import MODES

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


class Seen(NamedTuple):
    """What a controller is given in a tick."""

    time: float
    state: rust.State
    thrust: NDArray[np.float64]
    feet: NDArray[np.float64]


Change = Callable[[Seen], Seen]


class Misled(rust.Controller):
    """A controller whose measurement is changed on its way."""

    def __init__(self, config: Mapping[str, Any], change: Change) -> None:
        super().__init__(config)
        self._change = change

    def tick(
        self,
        state: rust.State,
        thrust: ArrayLike,
        wind: ArrayLike,
        time: float = 0.0,
        setpoint: rust.Setpoint | None = None,
        foot_wrenches: ArrayLike | None = None,
        preview: rust.Preview | None = None,
        residual: rust.Residual | None = None,
    ) -> rust.Tick:
        """Compute one tick of the changed measurement."""
        seen = self._change(Seen(time, state, np.array(thrust), np.array(foot_wrenches)))
        return super().tick(seen.state, seen.thrust, wind, time, setpoint, seen.feet, preview, residual)


class Failing(mujoco_ground.GroundPlant):
    """A robot one of whose jets stops after some ticks."""

    def __init__(self, config: Mapping[str, Any], jet: int, after: int) -> None:
        super().__init__(config)
        self._jet, self._left = jet, after

    def advance(self, torque: NDArray[np.float64], thrust_rate: NDArray[np.float64]) -> None:
        """Advance by one tick."""
        super().advance(torque, thrust_rate)
        self._left -= 1
        if self._left <= 0:
            self.thrust[self._jet] = 0.0


def take_off(
    wind: tuple[float, ...] | None, *, change: Change | None = None, engine: tuple[int, int] | None = None
) -> rust.FlightResult:
    """Fly from the ground to the ground, in the experiment's own wind if `wind` is `None`."""
    blows = {} if wind is None else {"wind.velocity": list(wind)}
    config = rust.load_config("take_off", {"simulator.duration": DURATION} | blows)
    controller = rust.Controller if change is None else partial(Misled, change=change)
    plant = mujoco_ground.GroundPlant if engine is None else partial(Failing, jet=engine[0], after=engine[1])
    with mock.patch.object(rust, "Controller", controller), mock.patch.object(mujoco_ground, "GroundPlant", plant):
        return mujoco_ground.fly(config)


def _row(case: str, flight: rust.FlightResult) -> Row:
    modes = flight["degraded_modes"].astype(int)
    return {
        "case": case,
        "completed": flight.outcome == "completed",
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
    last = [np.zeros(0)]

    def change(seen: Seen) -> Seen:
        if seen.time < start or what == "right":
            last[0] = seen.feet
            return seen
        if what in ("foot_wrenches", "frozen", "zero"):
            feet = {"foot_wrenches": np.nan * seen.feet, "frozen": last[0], "zero": 0.0 * seen.feet}[what]
            return seen._replace(feet=feet)
        lost = np.array(getattr(seen.state, what))
        lost[:6] = np.nan  # of the velocity that of the base
        return seen._replace(state=seen.state._replace(**{what: lost}))

    return change


def take_off_engines(every: int) -> list[Row]:
    """Stop an engine of take_off before lift-off, which is at 3.8 s."""
    flights = islice(product(range(4), (50, 100, 150, 200, 250, 275, 300, 400)), 0, None, every)
    return [_row(f"stops at {0.01 * after:g} s", take_off(None, engine=(jet, after))) for jet, after in flights]


def take_off_scaled(every: int) -> list[Row]:
    """Measure all thrusts of take_off wrong by a share."""

    def scale(share: float) -> Change:
        return lambda seen: seen._replace(thrust=(1.0 + share) * seen.thrust)

    flights = islice(product((-0.2, -0.15, -0.1, -0.05, 0.05, 0.1, 0.15, 0.2), WINDS[:2]), 0, None, every)
    return [_row(f"{share:+.0%}", take_off(wind, change=scale(share))) for share, wind in flights]


PARTS: Mapping[str, Callable[[int], list[Row]]] = {
    part.__name__: part for part in (take_off_base, take_off_engines, take_off_scaled)
}
