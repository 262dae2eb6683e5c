"""The closed-loop flight as pure functions: one tick, the scan over ticks, `fly` for one, `fly_batch` for many."""

from jax_aero.sim.batch import fly_batch
from jax_aero.sim.rollout import everything, fly, rollout
from jax_aero.sim.step import Flight, FlightRow, FlightState, begin, prepare, step

__all__ = [
    "Flight",
    "FlightRow",
    "FlightState",
    "begin",
    "everything",
    "fly",
    "fly_batch",
    "prepare",
    "rollout",
    "step",
]
