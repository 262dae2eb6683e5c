"""The acceleration that a command of the crate lets expect: M101 of `docs/model/detection.md`, in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def whole(tick: Any, wrench: NDArray[np.float64], base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the acceleration of the base of a robot that a wrench moves as one body, (6,)."""
    mass = tick.momentum_matrix[0, 0]
    turning = np.linalg.solve(tick.centroidal_inertia, wrench[3:])
    return np.concatenate([wrench[:3] / mass - np.cross(turning, tick.com_position - base), turning])


def acceleration(robot: Any, tick: Any, share: NDArray[np.float64] | float = 1.0) -> NDArray[np.float64]:
    """Return ν̇ under the command of a tick in the air, (6 + n,); of its torques a `share` acts.

    The law's own joint accelerations are those of its equations of motion; the base's follow from its six rows.
    """
    base, unmodelled = np.asarray(tick.estimates.state.base_position), tick.unmodelled_wrench
    joints = tick.joint_acceleration_free + tick.torque_gain @ (share * tick.joint_torque)
    force, moment = np.split(tick.momentum_rate_estimate - unmodelled, 2)
    force = force + np.array([0.0, 0.0, robot.mass * robot.gravity])
    acting = np.concatenate([force, moment + np.cross(tick.com_position - base, force)])
    rows = tick.mass_matrix[:6]
    of_base = np.linalg.solve(rows[:, :6], acting - tick.bias[:6] - rows[:, 6:] @ joints)
    return np.concatenate([of_base + whole(tick, unmodelled, base), joints])
