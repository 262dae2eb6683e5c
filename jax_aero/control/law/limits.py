"""What the law may use in a tick: as configured, or as the guard allows."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from jax_aero.control.law.attitude import MomentumGains
from jax_aero.types import Array


class Limits(NamedTuple):
    """Gains and limits of a tick; `j` jets, `n` joints."""

    gains: MomentumGains
    """Gains of the momentum and attitude tasks."""
    holds_position: Bool[Array, ""]
    """Whether the centre of mass is held at its set-point; otherwise only its velocity is controlled (M107)."""
    thrust_least: Float[Array, " j"]
    """Least thrusts [N]."""
    thrust_greatest: Float[Array, " j"]
    """Greatest thrusts [N]."""
    joint_velocity: Float[Array, " n"]
    """Greatest joint velocities [rad/s]."""
    torque_rate: Float[Array, " n"]
    """Greatest torque rates [N m/s]."""
    torque_share: Float[Array, " n"]
    """Share of the commanded torque that acts; zero for free joints."""
    is_stuck: Bool[Array, " n"]
    """Which joints keep their positions."""

    @property
    def joint_condition(self) -> Int[Array, " n"]:
        """Return what is found of each joint: 0 healthy, 1 stuck, 2 weak, 3 free."""
        share = self.torque_share
        return jnp.where(self.is_stuck, 1, jnp.where(share == 0.0, 3, jnp.where(share < 1.0, 2, 0)))
