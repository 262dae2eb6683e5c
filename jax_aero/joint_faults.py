"""Faults of joints: stuck, weak, free.

Faults are numbers, not structure, so flights with different faults share one compilation.

Equation M142 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.config import JointFault
from jax_aero.robot import RobotModel
from jax_aero.types import Array, leaf


class JointFaults(NamedTuple):
    """Faults of `n` joints; without a fault the numbers have no effect."""

    share: Float[Array, " n"]
    """Share of the torque that acts after the onset."""
    is_stuck: Bool[Array, " n"]
    """Whether the joint keeps its position after the onset."""
    is_faulty: Bool[Array, " n"]
    """Which joints have a fault."""


class JointFaultState(NamedTuple):
    """State of the faults between two ticks."""

    left: Float[Array, " n"]
    """Time until the onset [s]; negative after it."""
    held: Float[Array, " n"]
    """Position at the onset [rad, m]."""
    acts: Bool[Array, " n"]
    """Whether the fault acts."""


def start_faults(faults: Sequence[JointFault], robot: RobotModel) -> tuple[JointFaults, JointFaultState]:
    """Return the faults of a flight, and their initial state; the crate has checked their names."""
    share, left = np.ones(robot.n_joints), np.zeros(robot.n_joints)
    is_stuck, is_faulty = np.zeros((2, robot.n_joints), bool)
    for fault in faults:
        joint = robot.joint_names.index(fault.joint)
        share[joint] = {"stuck": 1.0, "weak": fault.share, "free": 0.0}[fault.kind]
        is_stuck[joint], is_faulty[joint], left[joint] = fault.kind == "stuck", True, fault.start
    none = jnp.zeros(robot.n_joints)
    state = JointFaultState(jnp.asarray(leaf(left)), none, none > 0.0)
    return JointFaults(jnp.asarray(leaf(share)), jnp.asarray(is_stuck), jnp.asarray(is_faulty)), state


def begin_tick(
    faults: JointFaults, state: JointFaultState, dt: Float[Array, ""], position: Float[Array, " n"]
) -> JointFaultState:
    """Begin a tick of `dt` [s] in these joint positions: faults whose time has come act from here on."""
    # Half a tick absorbs rounding in the sum of the ticks.
    acts = faults.is_faulty & (state.left < 0.5 * dt)
    return JointFaultState(state.left - dt, jnp.where(acts & ~state.acts, position, state.held), acts)


def reduce_torque(faults: JointFaults, state: JointFaultState, torque: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the torques that act where these are commanded [N m]."""
    return jnp.where(state.acts, faults.share, 1.0) * torque
