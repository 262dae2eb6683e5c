"""What a disturbance of a flight is: a pytree of numbers that acts on what is measured, or on what acts on the plant.

    plant ──Measurement──► measure ──► controller ──Acting──► act ──► plant

`disturbances` lists those of a flight.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Float, Int

from jax_aero.control.measurement import Measurement
from jax_aero.sim.plant import Acting
from jax_aero.sim.wind import Wind
from jax_aero.types import Array


class Moment(NamedTuple):
    """A tick, and the winds as functions of time."""

    tick: Int[Array, ""]
    time: Float[Array, ""]
    """Time [s]."""
    time_step: Float[Array, ""]
    """Time between ticks [s]."""
    wind: Wind
    measured_wind: Wind
    """Wind that the controller measures: the true one, or another in its place."""


class Disturbance:
    """What disturbs a flight; a class of its own overrides what it does. `state` is its own, between two ticks."""

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Names of the scenario's numbers from which those of this were computed or drawn."""
        return ()

    def start(self, first: Measurement) -> Any:  # noqa: ARG002
        """Return the state at the first tick, given its true values."""
        return ()

    def measure(self, state: Any, given: Measurement, moment: Moment) -> tuple[Any, Measurement]:  # noqa: ARG002
        """Return the next state, and what comes out of what is `given` to be measured."""
        return state, given

    def act(self, state: Any, given: Acting, step: Float[Array, ""]) -> tuple[Any, Acting]:  # noqa: ARG002
        """Return the next state, and what acts in the sub-steps of a tick, of `step` [s] each."""
        return state, given
