"""Pushes: forces and moments on bodies of the simulated robot, each for a time.

Bodies are structure; wrenches and times are numbers.

Equation M155 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.body.robot import RobotModel
from jax_aero.config import Push
from jax_aero.control.measurement import Measurement
from jax_aero.sim.disturbance import Disturbance
from jax_aero.sim.plant import Acting, Wrenches
from jax_aero.types import Array, leaf, pytree, static


@pytree
class Pushes(Disturbance):
    """Pushes of a flight. The state are the times until their starts [s], negative after it."""

    bodies: tuple[int, ...] = static()
    forces: Float[Array, "p 3"]
    """At the bodies' centres of mass [N], inertial axes."""
    moments: Float[Array, "p 3"]
    """[N m], inertial axes."""
    starts: Float[Array, " p"]
    """[s]."""
    durations: Float[Array, " p"]
    """[s]."""

    def start(self, first: Measurement) -> Float[Array, " p"]:  # noqa: ARG002
        """Return the times until the pushes start."""
        return jnp.asarray(self.starts)

    def act(
        self, state: Float[Array, " p"], given: Acting, step: Float[Array, ""]
    ) -> tuple[Float[Array, " p"], Acting]:
        """Add the mean force and moment over each sub-step."""
        shares = []
        for _ in given.torques:
            acts = jnp.minimum(state + self.durations, step) - jnp.maximum(state, 0.0)
            shares.append(jnp.maximum(acts, 0.0)[:, None] / step)
            state = state - step
        share = jnp.stack(shares)
        pushing = Wrenches(self.bodies, share * self.forces[None], share * self.moments[None])
        return state, given._replace(wrenches=(*given.wrenches, pushing))


def configured_pushes(pushes: Sequence[Push], robot: RobotModel) -> Pushes | None:
    """Return the pushes of a flight, if any; the crate has checked their bodies."""
    if not pushes:
        return None
    bodies = tuple(robot.body_names.index(push.body) for push in pushes)
    return Pushes(
        bodies, *(leaf([getattr(push, name) for push in pushes]) for name in ("force", "moment", "start", "duration"))
    )
