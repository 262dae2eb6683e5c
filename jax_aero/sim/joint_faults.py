"""Faults of joints: stuck, weak, free.

Joints are structure; what becomes of each, and when, are numbers.

Equation M142 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.body.robot import RobotModel
from jax_aero.config import JointFault
from jax_aero.types import Array, leaf, pytree, static

SHARES = {"stuck": 1.0, "weak": 0.5, "free": 0.0}
"""Share of the torque that acts, by kind."""


class JointFaultsState(NamedTuple):
    """State of the faults between two ticks."""

    left: Float[Array, " f"]
    """Times until the onsets [s], negative after them."""
    has_begun: Bool[Array, " f"]
    onset: Float[Array, " f"]
    """Position at the onset, before it the last one [rad, m]."""


@pytree
class JointFaults:
    """Faults of a flight, at most one of each joint."""

    joints: tuple[int, ...] = static()
    share: Float[Array, " f"]
    """Share of the torque that acts."""
    is_stuck: Bool[Array, " f"]
    """Whether the joint keeps its position."""
    start: Float[Array, " f"]
    """Time from which the fault acts [s]."""

    @property
    def places(self) -> np.ndarray[tuple[int], np.dtype[np.int_]]:
        """Indices of the joints."""
        return np.array(self.joints, dtype=int)

    def begin(self, joint_position: Float[Array, " n"]) -> JointFaultsState:
        """Return the state before the first tick."""
        left = jnp.asarray(self.start)
        return JointFaultsState(left, jnp.zeros(left.shape, bool), joint_position[self.places])

    def begin_tick(
        self, state: JointFaultsState, time_step: Float[Array, ""], joint_position: Float[Array, " n"]
    ) -> JointFaultsState:
        """Return the state in a tick that begins in these joint positions."""
        # Half a tick absorbs rounding in the sum of the ticks.
        has_begun = state.has_begun | (state.left < 0.5 * time_step)
        onset = jnp.where(state.has_begun, state.onset, joint_position[self.places])
        return JointFaultsState(state.left - time_step, has_begun, onset)

    def reduce(self, state: JointFaultsState, torque: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the torques that act where these are commanded [N m, N]."""
        return torque.at[self.places].multiply(jnp.where(state.has_begun, self.share, 1.0))

    def stuck(self, state: JointFaultsState, joints: int) -> tuple[Bool[Array, " n"], Float[Array, " n"]]:
        """Return which of the joints are stuck, and the positions that these keep [rad, m]."""
        held = jnp.zeros(joints, state.onset.dtype).at[self.places].set(state.onset)
        return jnp.zeros(joints, bool).at[self.places].set(state.has_begun & self.is_stuck), held


def joint_faults(faults: Sequence[JointFault], robot: RobotModel) -> JointFaults | None:
    """Return the faults of a flight, if any; the crate has checked their joints."""
    if not faults:
        return None
    return JointFaults(
        tuple(robot.joint_names.index(fault.joint) for fault in faults),
        leaf([SHARES[fault.kind] for fault in faults]),
        jnp.array([fault.kind == "stuck" for fault in faults]),
        leaf([fault.start for fault in faults]),
    )
