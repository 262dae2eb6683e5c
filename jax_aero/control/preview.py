"""What is known of the future at a tick: set-points and wind."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.body.spatial import log_so3, multiply
from jax_aero.control.law.recorded import Recording, motion_at
from jax_aero.control.law.setpoint import motion_of
from jax_aero.types import Array, Setpoint


class Preview(NamedTuple):
    """What is known of the future at a tick, which only the predictive law reads; by default nothing.

    Times are those after the tick [s], increasing. Unlike the crate this does not check them.
    """

    setpoints: tuple[Float[Array, " k"], Setpoint] | None = None
    """Times above zero, and the set-points that follow a given one, along an additional first axis: interpolated
    between, extrapolated after the last one. A mission has its own."""
    wind: Float[Array, "_ 4"] | None = None
    """Time, from zero on, and velocity of the air [m/s, inertial axes]: linear between samples, constant outside. The
    prediction has its change from time zero."""


def setpoints_at(times: Float[Array, " k"], setpoints: Setpoint, now: Setpoint, ahead: Float[Array, " r"]) -> Setpoint:
    """Return the set-points at times ahead [s], along an additional first axis; `now` is that of the tick.

    As between samples of a recording (M49), the other derivatives linear; after the last time the last one.
    """
    every: Setpoint = jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), now, setpoints)
    samples = jax.vmap(motion_of)(every)
    turns = log_so3(multiply(jnp.swapaxes(samples.rotation[:-1], 1, 2), samples.rotation[1:]))
    known = Recording(jnp.concatenate([jnp.zeros_like(times[:1]), times]), samples, turns)

    def linear(values: Array, time: Array) -> Array:
        return jnp.stack([jnp.interp(time, known.times, component) for component in values.T])

    def one(time: Array) -> Setpoint:
        motion = motion_at(known, time)
        position, velocity, acceleration, jerk = motion.com
        return Setpoint(
            position,
            velocity,
            acceleration,
            jerk,
            motion.rotation,
            motion.angular_velocity,
            linear(every.angular_acceleration, time),
            linear(every.angular_jerk, time),
        )

    later: Setpoint = jax.vmap(one)(jnp.minimum(ahead, times[-1]))
    return later


def wind_change(wind: Float[Array, "k 4"], ahead: Float[Array, " r"]) -> Float[Array, "r 3"]:
    """Return the change of the wind from the tick to times ahead [s; m/s]."""
    times, velocities = wind[:, 0], wind[:, 1:]

    def at(component: Array) -> Array:
        return jnp.interp(ahead, times, component) - jnp.interp(0.0, times, component)

    return jnp.stack([at(component) for component in velocities.T], axis=1)
