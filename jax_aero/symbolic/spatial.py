"""Rotations and rigid transforms as symbolic expressions.

Equations M2 and M3 of `docs/model`.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from jax_aero.symbolic.robot import Array

SX = ca.SX


def constant(numbers: Array) -> SX:
    """Return numbers as an expression."""
    return ca.SX(ca.DM(numbers))


def turn_about(axis: Array, angle: SX | float) -> SX:
    """Return the rotation by an angle about a constant unit axis: 1 + sin S + (1 − cos) S²."""
    s = ca.skew(ca.DM(axis))
    return ca.SX.eye(3) + ca.sin(angle) * s + (1 - ca.cos(angle)) * ca.mtimes(s, s)


def turn_from_rpy(rpy: SX) -> SX:
    """Return Rz(yaw) Ry(pitch) Rx(roll)."""
    x, y, z = np.eye(3)
    return ca.mtimes([turn_about(z, rpy[2]), turn_about(y, rpy[1]), turn_about(x, rpy[0])])


def small_turn(phi: SX) -> SX:
    """Return the Cayley rotation (1 − S(φ)/2)⁻¹ (1 + S(φ)/2).

    It agrees with exp S(φ) to second order. At φ = 0 the rate of φ is therefore the angular velocity and its second
    derivative the angular acceleration: φ are local coordinates of rotations, free of singularities at φ = 0.
    """
    s = ca.skew(phi)
    return ca.SX.eye(3) + (s + 0.5 * ca.mtimes(s, s)) / (1 + 0.25 * ca.dot(phi, phi))


@dataclass(frozen=True)
class Pose:
    """A rigid transform `a_from_b`."""

    rotation: SX
    position: SX

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: `a_from_b @ b_from_c`."""
        return Pose(ca.mtimes(self.rotation, other.rotation), self.point(other.position))

    def point(self, point_b: SX | Array) -> SX:
        """Transform a point from frame b to frame a."""
        return self.position + self.direction(point_b)

    def direction(self, vector_b: SX | Array) -> SX:
        """Rotate a direction from frame b to frame a."""
        return ca.mtimes(self.rotation, constant(vector_b) if isinstance(vector_b, np.ndarray) else vector_b)
