"""What a tick measures, and the measurement as it is used."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Bool, Float, Int

from jax_aero.control.preview import Preview
from jax_aero.types import Array, State


class Measurement(NamedTuple):
    """Input of a controller at a tick."""

    time: Float[Array, ""]
    """Time since the flight began [s]."""
    state: State
    thrust: Float[Array, " j"]
    """Measured thrusts [N]."""
    wind: Float[Array, "3"]
    """Measured velocity of the air [m/s, inertial axes]."""
    preview: Preview = Preview()
    """What is known of the future."""


class Reading(NamedTuple):
    """A robot's state, measured or estimated."""

    state: State
    thrust: Float[Array, " j"]
    """Thrusts [N]."""


class UsedMeasurement(NamedTuple):
    """The measurement as a tick uses it: predicted where it is not measured."""

    time: Float[Array, ""]
    """Time of the controller: that of the measurement, corrected for jumps of its clock [s]."""
    state: State
    thrust: Float[Array, " j"]
    wind: Float[Array, "3"]
    modes: Int[Array, ""]
    """Sum of the bits of `MODES`."""
    thrust_innovation: Float[Array, " j"]
    """Measured minus predicted thrust, or an estimator's correction of it; zero for thrusts that are not measured
    [N]."""
    elapsed: Float[Array, ""]
    """Time since the last tick [s]; one time step if unknown."""
    pause: Float[Array, ""]
    """Advance of the measurements' clock [s] if the time since the last tick is unknown, because either the clock has
    jumped or the controller has paused. Zero if that time is known or the advance is too long for a pause."""
    has_momentum: Bool[Array, ""]
    """Whether the momentum is computed from measurements and the time since the last tick is known."""
