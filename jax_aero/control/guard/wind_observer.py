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
from jax_aero.control.guard import observer
from jax_aero.control.guard.observer import ObserverGains, ObserverState
from jax_aero.robot import RobotModel
from jax_aero.types import Array, Kinematics, pytree, where

DIFFERENCE = 0.1
"""Step of the finite differences for the Jacobian [m/s]."""

MEMORY = 2.0
"""Time over which the unexplained moment is averaged [s]."""

GREATEST = 1e4
"""Greatest wrench that is used for the estimate [N, N m]."""


@pytree
class WindObserver:
    """Parameters of the wind estimate."""

    gain: Float[Array, ""]
    """`K_o` of the force [1/s]."""
    walk: Float[Array, ""]
    """Standard deviation of the change of a horizontal wind in one second [m/s]."""
    vertical_std: Float[Array, ""]
    """Standard deviation of vertical winds [m/s]."""
    vertical_time: Float[Array, ""]
    """Correlation time of vertical winds [s]."""
    force_noise: Float[Array, "3"]
    """Standard deviation of the noise of the observed force [N]."""
    force_std: Float[Array, ""]
    """Standard deviation of lasting errors of the force [N]."""
    relative_std: Float[Array, ""]
    """Standard deviation of lasting errors of the model's force, as a fraction of the observed one."""
    moment_arm: Float[Array, ""]
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


def start(settings: WindObserver) -> WindState:
    """Return the state before the first tick: zero wind, with the uncertainty of one second of its random walk."""
    std = jnp.stack([jnp.asarray(x) for x in (settings.walk, settings.walk, settings.vertical_std)])
    zero = jnp.zeros_like(std[0])
    none = jnp.zeros((3, 3), std.dtype)
    return WindState(observer.start(std), jnp.zeros_like(std), jnp.diag(std * std), none, zero, zero)


def update(
    settings: WindObserver,
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
    greatest = jnp.full_like(settings.gain, GREATEST)
    gains = ObserverGains(settings.gain, settings.gain, greatest, greatest)
    wrench = observer.update(gains, step, before.wrench, momentum, rate)
    force = wrench.wrench[:3]

    # Horizontal winds are a random walk; vertical ones return to zero.
    kept = jnp.exp(-step / settings.vertical_time)
    keep = jnp.stack([jnp.ones_like(kept), jnp.ones_like(kept), kept])
    walk = settings.walk**2 * step
    wandering = jnp.diag(jnp.stack([walk, walk, settings.vertical_std**2 * (1.0 - kept * kept)]))
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
    lasting = (
        settings.force_std**2 + settings.relative_std**2 * jnp.sum(force * force) + unexplained / settings.moment_arm**2
    )
    # The observer correlates measurements over its time constant, so those count as one.
    together = jnp.maximum(1.0 / (settings.gain * step), 1.0)
    error = jnp.diag(together * settings.force_noise**2)
    innovation = jacobian @ covariance @ jacobian.T + error
    gain = jnp.linalg.solve(innovation, jacobian @ covariance).T
    moved = wind + gain @ (force - modelled[:3])
    left = jnp.eye(3, dtype=wind.dtype) - gain @ jacobian
    # Joseph form, which keeps the covariance symmetric and positive under rounding.
    less = left @ covariance @ left.T + gain @ error @ gain.T
    sensitivity = keep[:, None] * before.sensitivity
    after = WindState(wrench, moved, less, left @ sensitivity + gain, lasting, unexplained)
    before = WindState(wrench, wind, covariance, sensitivity, before.lasting, before.unexplained)
    is_finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in after[1:]]))
    return where(is_finite, after, before)
