"""Wind estimate from the wrench on the robot, by inversion of an aerodynamic model.

```text
dẑ/dt = K_o (L̇ − A_T T + m g e₃ − ẑ)                   wrench of all but jets and weight
ẑ_f = Σ f_j(v_w) + noise + e,  dv_w = random walk       an extended Kalman filter, e constant
```

It runs at the end of a controller tick on the values computed there; its wind is used by the next tick.

Equations M94 and M110 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.aero import AeroModel, LinkConventions, link_forces, wrench_about
from jax_aero.body.linalg import solve_positive_definite
from jax_aero.body.robot import RobotModel
from jax_aero.control.estimate import disturbance_observer
from jax_aero.control.estimate.disturbance_observer import ObserverGains, ObserverState
from jax_aero.types import Array, Kinematics, where

DIFFERENCE = 0.1
"""Step of the finite differences for the Jacobian [m/s]."""

MEMORY = 2.0
"""Time over which the unexplained moment is averaged [s]."""

GREATEST = 1e4
"""Greatest wrench that is used for the estimate [N, N m]."""


GAIN = 10.0
"""`K_o`, with which the acting force is observed [1/s]."""

WALK = 0.6
"""Standard deviation of the change of a horizontal wind in one second [m/s]."""

VERTICAL_STD = 1.0
"""Standard deviation of vertical winds [m/s]."""

VERTICAL_TIME = 2.0
"""Correlation time of vertical winds [s]."""

FORCE_NOISE = (0.3, 0.3, 4.0)
"""Standard deviation of the noise of the observed force along each axis [N]."""

FORCE_STD = 0.1
"""Standard deviation of lasting errors of the force [N]."""

RELATIVE_STD = 0.045
"""Standard deviation of lasting errors of the model's force, as a fraction of the observed one."""

MOMENT_ARM = 0.25
"""Arm by which the unexplained moment is converted into a lasting force error [m]."""


class WindState(NamedTuple):
    """State of the estimate between two ticks."""

    wrench: ObserverState
    wind: Float[Array, "3"]
    """Estimated wind [m/s, inertial axes]."""
    covariance: Float[Array, "3 3"]
    """Covariance of the estimate, without lasting errors [m²/s²]."""
    sensitivity: Float[Array, "3 3"]
    """Derivative of the estimate with respect to a lasting force error [m/s/N]."""
    lasting: Float[Array, ""]
    """Variance of the lasting errors [N²]."""
    unexplained: Float[Array, ""]
    """Mean square of the moment that the model does not explain [N² m²]."""

    @property
    def std(self) -> Float[Array, "3"]:
        """Return the standard deviation of the wind along each axis [m/s]."""
        considered = self.covariance + self.lasting * self.sensitivity @ self.sensitivity.T
        return jnp.sqrt(jnp.diagonal(considered))


def start(like: Float[Array, "..."]) -> WindState:
    """Return the state before the first tick in the precision of `like`: zero wind, uncertain by a second's walk."""
    std, zero = jnp.array([WALK, WALK, VERTICAL_STD], like.dtype), jnp.zeros((), like.dtype)
    none = jnp.zeros((3, 3), std.dtype)
    return WindState(disturbance_observer.start(std), jnp.zeros_like(std), jnp.diag(std * std), none, zero, zero)


def update(
    robot: RobotModel,
    aero: AeroModel,
    step: Float[Array, ""],
    before: WindState,
    kinematics: Kinematics,
    momentum: Float[Array, "6"],
    a_t: Float[Array, "6 j"],
    thrust: Float[Array, " j"],
) -> WindState:
    """Process a tick, `step` [s] after the last one: centroidal momentum [kg m/s, kg m²/s], `A_T` and thrusts [N]."""
    rate = jnp.sum(a_t * thrust[None], axis=1).at[2].add(-robot.mass * robot.gravity)
    gains = ObserverGains(*(jnp.full_like(step, x) for x in (GAIN, GAIN, GREATEST, GREATEST)))
    wrench = disturbance_observer.update(gains, step, before.wrench, momentum, rate)
    force = wrench.wrench[:3]

    # Horizontal winds are a random walk; vertical ones return to zero.
    kept = jnp.exp(-step / VERTICAL_TIME)
    keep = jnp.stack([jnp.ones_like(kept), jnp.ones_like(kept), kept])
    walk = WALK**2 * step
    wandering = jnp.diag(jnp.stack([walk, walk, VERTICAL_STD**2 * (1.0 - kept * kept)]))
    wind, covariance = keep * before.wind, keep[:, None] * before.covariance * keep[None] + wandering

    def wrench_in(wind: Array) -> Array:
        link = link_forces(aero, robot, kinematics, LinkConventions(), wind)
        return wrench_about(link, kinematics.com)

    modelled = wrench_in(wind)
    shifted = jax.vmap(wrench_in)(wind[None] + DIFFERENCE * jnp.eye(3, dtype=wind.dtype))
    jacobian = ((shifted - modelled[None])[:, :3] / DIFFERENCE).T
    share = -jnp.expm1(-step / MEMORY)
    moment = jnp.sum((wrench.wrench - modelled)[3:] ** 2)
    unexplained = before.unexplained + share * (moment - before.unexplained)
    lasting = FORCE_STD**2 + RELATIVE_STD**2 * jnp.sum(force * force) + unexplained / MOMENT_ARM**2
    # The observer correlates measurements over its time constant, so those count as one.
    together = jnp.maximum(1.0 / (GAIN * step), 1.0)
    error = jnp.diag(together * jnp.array(FORCE_NOISE, wind.dtype) ** 2)
    innovation = jacobian @ covariance @ jacobian.T + error
    gain = solve_positive_definite(innovation, jacobian @ covariance).T
    moved = wind + gain @ (force - modelled[:3])
    left = jnp.eye(3, dtype=wind.dtype) - gain @ jacobian
    # Joseph form, which keeps the covariance symmetric and positive under rounding.
    less = left @ covariance @ left.T + gain @ error @ gain.T
    sensitivity = keep[:, None] * before.sensitivity
    after = WindState(wrench, moved, less, left @ sensitivity + gain, lasting, unexplained)
    before = WindState(wrench, wind, covariance, sensitivity, before.lasting, before.unexplained)
    is_finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in after[1:]]))
    return where(is_finite, after, before)
