"""The closed-loop flight as pure functions: one tick, the scan over ticks, `fly` for one, `fly_batch` for many.

`prepare` builds a `Scenario`, whose controller, aerodynamics and jets may be user-defined; `run` flies it to its end.
"""

from jax_aero.base.result import FlightResult
from jax_aero.control import Command, Controller, Measurement
from jax_aero.sim.batch import fly_batch
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.sim.preparation import prepare
from jax_aero.sim.rollout import fly, keep_row, rollout, run
from jax_aero.sim.scenario import Scenario, convert_precision
from jax_aero.sim.signals import FlightRow
from jax_aero.sim.step import FlightState, begin, step

__all__ = [
    "COMPILER_OPTIONS",
    "Command",
    "Controller",
    "FlightResult",
    "FlightRow",
    "FlightState",
    "Measurement",
    "Scenario",
    "begin",
    "convert_precision",
    "fly",
    "fly_batch",
    "keep_row",
    "prepare",
    "rollout",
    "run",
    "step",
]
