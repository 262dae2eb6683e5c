"""Rotations in NumPy: matrices, quaternions `wxyz`, and roll, pitch and yaw; `jax_aero.body.spatial` has them in JAX.

Equations M1 to M5 of `docs/model.md`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def rotation_from_wxyz(wxyz: ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4) of any nonzero length."""
    quaternions = np.asarray(wxyz, dtype=np.float64)
    w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def wxyz_from_rotation(rotations: ArrayLike) -> Array:
    """Return the quaternions (..., 4) of rotation matrices (..., 3, 3), with w ≥ 0."""
    r = np.asarray(rotations, dtype=np.float64)
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(r, (-2, -1), (0, 1))
    # 4 q qᵀ for q = (w, x, y, z); its column with the greatest entry on the diagonal, divided by the root of that.
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    greatest = np.argmax(np.einsum("ii...->i...", products), axis=0)
    columns = np.take_along_axis(products, greatest[None, None], axis=1)[:, 0]
    wxyz = np.moveaxis(columns / np.linalg.norm(columns, axis=0), 0, -1)
    return np.asarray(np.where(wxyz[..., :1] < 0.0, -wxyz, wxyz))


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Return the rotations Rz(yaw) Ry(pitch) Rx(roll), (..., 3, 3), of angles (..., 3) [rad]."""
    angles = np.moveaxis(np.asarray(rpy, dtype=np.float64), -1, 0)
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rpy_from_rotation(rotations: ArrayLike) -> Array:
    """Return roll, pitch and yaw (..., 3) [rad] of rotation matrices (..., 3, 3), pitch in [−π/2, π/2]."""
    r = np.moveaxis(np.asarray(rotations, dtype=np.float64), (-2, -1), (0, 1))
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    return np.stack([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])], axis=-1)


def rotation_angle(rotations: ArrayLike) -> Array:
    """Return the angles (...) of rotation matrices (..., 3, 3) [rad], in [0, π]."""
    wxyz = wxyz_from_rotation(rotations)
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(wxyz[..., 1:], axis=-1), wxyz[..., 0]))


def match_branch(signal: str, ours: Array, theirs: Array) -> Array:
    """Return, of equivalent values of a logged signal (n, ...), those nearest to others: iRonCub starts at a yaw of π.

    Both signs of a quaternion are one rotation, as are angles a turn apart; other signals stay.
    """
    if signal.endswith("base_quaternion"):
        return np.asarray(ours * np.where(np.sum(ours * theirs, axis=1) < 0.0, -1.0, 1.0)[:, None])
    if signal == "base_rpy_setpoint":
        return np.asarray(ours - 2.0 * np.pi * np.round((ours - theirs) / (2.0 * np.pi)))
    return ours
