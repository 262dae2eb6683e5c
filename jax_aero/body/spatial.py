"""Rotations and small vectors, with finite derivatives everywhere in reverse and forward mode.

Transforms are named `a_from_b`: `p_a = a_from_b @ p_b`. Quaternions are `wxyz`.

Equations M1 to M5 of `docs/model`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.types import Array


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the matrix `S(v)` with `S(v) u = v × u`."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = jnp.zeros_like(x)
    return jnp.stack([jnp.stack([o, -z, y], -1), jnp.stack([z, o, -x], -1), jnp.stack([-y, x, o], -1)], -2)


def multiply(a: Float[Array, "*#batch 3 3"], b: Float[Array, "*#batch 3 3"]) -> Float[Array, "*#batch 3 3"]:
    """Multiply 3×3 matrices as sums of products, which XLA fuses, unlike many small dot products."""
    first, second, third = (a[..., :, k : k + 1] * b[..., k : k + 1, :] for k in range(3))
    return first + second + third


def rotate(a: Float[Array, "*#batch 3 3"], v: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """Return `A v` of 3×3 matrices and vectors; see `multiply`."""
    return jnp.sum(a * v[..., None, :], -1)


def rotate_back(a: Float[Array, "*#batch 3 3"], v: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """Return `Aᵀ v` of 3×3 matrices and vectors; see `multiply`."""
    return jnp.sum(a * v[..., :, None], -2)


def trace(a: Float[Array, "*batch 3 3"]) -> Float[Array, " *batch"]:
    """Return the trace of a 3×3 matrix."""
    return a[..., 0, 0] + a[..., 1, 1] + a[..., 2, 2]


def inverse(a: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Return the inverse of a 3×3 matrix with rows a, b, c; its columns are `b × c / (a · b × c)` and cyclic."""
    columns = cross(jnp.roll(a, -1, axis=0), jnp.roll(a, -2, axis=0))
    return columns.T / jnp.sum(a[0] * columns[0])


def cross(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """Return `a × b` over the last axis, whose component `i + 2` is `a_i b_(i+1) − a_(i+1) b_i`, indices modulo 3."""

    def following(v: Array) -> Array:
        return jnp.concatenate([v[..., 1:], v[..., :1]], -1)

    return following(a * following(b) - following(a) * b)


def vee_of_skew_part(a: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return the vector of the antisymmetric part, `sk(A)^∨` with `sk(A) = (A − Aᵀ)/2`; inverse of `skew`."""
    part = 0.5 * (a - jnp.swapaxes(a, -1, -2))
    return jnp.stack([part[..., 2, 1], part[..., 0, 2], part[..., 1, 0]], -1)


def exp_so3(phi: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation by the vector `phi` [rad]: `exp(S(φ)) = I + A S + B S²`, with `S² = φ φᵀ − θ² I`.

    `A = sin θ/θ` and `B = (1 − cos θ)/θ²` are even in θ, and thus smooth functions of `θ²`, also at zero.
    """
    square = jnp.sum(phi * phi, -1)[..., None, None]
    a, b = _sinc_and_cosc(square)
    s = skew(phi)
    eye = jnp.broadcast_to(jnp.eye(3, dtype=phi.dtype), s.shape)
    return (1.0 - b * square) * eye + a * s + b * phi[..., :, None] * phi[..., None, :]


def _sinc_and_cosc(square: Array) -> tuple[Array, Array]:
    """Return `sin θ/θ` and `(1 − cos θ)/θ²` as functions of `θ²`."""
    is_small = square < 1e-2
    # `where` alone is not enough, since both branches are differentiated and d√u/du is infinite at 0.
    theta = jnp.sqrt(jnp.where(is_small, 1.0, square))
    half = jnp.sin(0.5 * theta) / (0.5 * theta)
    u = square
    sinc = 1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0 * (1.0 - u / 110.0))))
    cosc = 0.5 * (1.0 - u / 12.0 * (1.0 - u / 30.0 * (1.0 - u / 56.0 * (1.0 - u / 90.0 * (1.0 - u / 132.0)))))
    return jnp.where(is_small, sinc, jnp.sin(theta) / theta), jnp.where(is_small, cosc, 0.5 * half * half)


def axis_angle(axis: Float[Array, "*#batch 3"], angle: Float[Array, " *#batch"]) -> Float[Array, "*#batch 3 3"]:
    """Return the rotation about a unit axis by an angle [rad]."""
    s, c = jnp.sin(angle)[..., None, None], jnp.cos(angle)[..., None, None]
    outer = axis[..., :, None] * axis[..., None, :]
    return c * jnp.broadcast_to(jnp.eye(3, dtype=axis.dtype), outer.shape) + s * skew(axis) + (1.0 - c) * outer


def safe_norm(v: Float[Array, "*batch _"]) -> Float[Array, " *batch"]:
    """Return the length over the last axis, with gradient zero for the zero vector."""
    square = jnp.sum(v * v, -1)
    is_zero = square == 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))


def rotation_angle(r: Float[Array, "*batch 3 3"]) -> Float[Array, " *batch"]:
    """Return the angle of a rotation [rad], in [0, π]; accurate near both ends, since it avoids `acos`."""
    return jnp.arctan2(safe_norm(vee_of_skew_part(r)), 0.5 * (trace(r) - 1.0))


def log_so3(r: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return the rotation vector [rad] of a rotation by less than 180°, the inverse of `exp_so3`."""
    v = vee_of_skew_part(r)
    square, cosine = jnp.sum(v * v, -1), 0.5 * (trace(r) - 1.0)
    # For small θ, θ/sin θ = 1 + sin²θ/6 to the last bit. At 180° sin θ may be zero, and the axis is undefined.
    is_small = (cosine > 0.0) & (square < np.finfo(r.dtype).eps) | (square == 0.0)
    sine = jnp.sqrt(jnp.where(is_small, 1.0, square))
    factor = jnp.where(is_small, 1.0 + square / 6.0, jnp.arctan2(sine, cosine) / sine)
    return factor[..., None] * v


@jax.jit  # otherwise each operation would be compiled separately
def rotation_from_rpy(rpy: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return `Rz(yaw) Ry(pitch) Rx(roll)` for `rpy = (roll, pitch, yaw)` [rad]."""
    (sr, sp, sy), (cr, cp, cy) = jnp.moveaxis(jnp.sin(rpy), -1, 0), jnp.moveaxis(jnp.cos(rpy), -1, 0)
    return jnp.stack(
        [
            jnp.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], -1),
            jnp.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], -1),
            jnp.stack([-sp, cp * sr, cp * cr], -1),
        ],
        -2,
    )


def rpy_from_rotation(r: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return roll, pitch and yaw [rad] of a rotation, with pitch in [−π/2, π/2]; inverse of `rotation_from_rpy`.

    At gimbal lock (pitch within √ε of ±π/2) only the sum or difference of roll and yaw is defined, and roll is set to
    zero. All derivatives are finite.
    """
    cos_pitch = safe_norm(jnp.stack([r[..., 0, 0], r[..., 1, 0]], -1))
    pitch = jnp.arctan2(-r[..., 2, 0], cos_pitch)
    # At gimbal lock rounding would change roll and yaw by as much as setting roll to zero changes the attitude.
    is_locked = cos_pitch < np.sqrt(np.finfo(r.dtype).eps)
    roll = jnp.arctan2(jnp.where(is_locked, 0.0, r[..., 2, 1]), jnp.where(is_locked, 1.0, r[..., 2, 2]))
    sine, cosine = jnp.where(is_locked, -r[..., 0, 1], r[..., 1, 0]), jnp.where(is_locked, r[..., 1, 1], r[..., 0, 0])
    return jnp.stack([roll, pitch, jnp.arctan2(sine, cosine)], -1)


def project_to_so3(near: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the nearest rotation to a matrix close to one, by two Newton–Schulz steps `R ← R (3 I − RᵀR)/2`."""
    r = near
    for _ in range(2):
        r = 0.5 * r @ (3.0 * jnp.eye(3, dtype=r.dtype) - jnp.swapaxes(r, -1, -2) @ r)
    return r


def rotation_from_wxyz(wxyz: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation of a quaternion `wxyz`, which is normalised first."""
    q = wxyz / jnp.linalg.norm(wxyz, axis=-1, keepdims=True)
    w, v = q[..., 0, None, None], q[..., 1:]
    s = skew(v)
    rotation: Array = jnp.eye(3, dtype=wxyz.dtype) + 2.0 * (w * s + multiply(s, s))
    return rotation


def wxyz_from_rotation(r: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """Return the quaternion `wxyz` of a rotation, with `w ≥ 0`.

    Of four expressions that each divide by one component, the one with the largest divisor is used.
    """
    m = r
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    whole = trace(m)
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = jnp.stack(
        [
            jnp.stack([1.0 + whole, a, b, c], -1),
            jnp.stack([a, 1.0 + 2.0 * xx - whole, xy, xz], -1),
            jnp.stack([b, xy, 1.0 + 2.0 * yy - whole, yz], -1),
            jnp.stack([c, xz, yz, 1.0 + 2.0 * zz - whole], -1),
        ],
        -2,
    )
    best = jnp.argmax(jnp.diagonal(rows, axis1=-2, axis2=-1), -1)
    q = jnp.take_along_axis(rows, best[..., None, None], -2)[..., 0, :]
    q = q / jnp.linalg.norm(q, axis=-1, keepdims=True)
    return jnp.where(q[..., :1] < 0.0, -q, q)
