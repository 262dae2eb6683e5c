"""The closed-loop flight as pure functions: one tick, the scan over ticks, and `fly` for one flight with its log."""

from jax_aero.sim.rollout import everything, fly, rollout
from jax_aero.sim.step import Flight, FlightRow, FlightState, begin, prepare, step

__all__ = ["Flight", "FlightRow", "FlightState", "begin", "everything", "fly", "prepare", "rollout", "step"]
