"""What a tick measures."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float

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
    thrust_rate: Float[Array, " j"] | None = None
    """Rates that the thrusts have when this tick's begin to act, as predicted; `None` without engines [N/s]."""


class Reading(NamedTuple):
    """A robot's state, measured or estimated."""

    state: State
    thrust: Float[Array, " j"]
    """Thrusts [N]."""
