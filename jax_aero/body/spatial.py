"""Rotations and small vectors, of NumPy's or JAX's arrays; derivatives are finite in reverse and forward mode.

Transforms are named `a_from_b`: `p_a = a_from_b @ p_b`. Quaternions are `wxyz`.

Equations M1 to M5 of `docs/model`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from jax_aero.base.arrays import namespace

if TYPE_CHECKING:
    from jaxtyping import Float

    Array: TypeAlias = Any


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the matrix `S(v)` with `S(v) u = v × u`."""
    xp = namespace(v)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = xp.zeros_like(x)
    return xp.stack([xp.stack([o, -z, y], -1), xp.stack([z, o, -x], -1), xp.stack([-y, x, o], -1)], -2)


def multiply(a: Float[Array, "*#batch 3 3"], b: Float[Array, "*#batch 3 3"]) -> Float[Array, "*#batch 3 3"]:
    """Multiply 3×3 matrices as sums of products, which XLA fuses, unlike many small dot products."""
    first, second, third = (a[..., :, k : k + 1] * b[..., k : k + 1, :] for k in range(3))
    return first + second + third


def rotate(a: Float[Array, "*#batch 3 3"], v: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """Return `A v` of 3×3 matrices and vectors; see `multiply`."""
    return (a * v[..., None, :]).sum(-1)


def rotate_back(a: Float[Array, "*#batch 3 3"], v: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """Return `Aᵀ v` of 3×3 matrices and vectors; see `multiply`."""
    return (a * v[..., :, None]).sum(-2)


def trace(a: Float[Array, "*batch 3 3"]) -> Float[Array, " *batch"]:
    """Return the trace of a 3×3 matrix."""
    return a[..., 0, 0] + a[..., 1, 1] + a[..., 2, 2]


def inverse(a: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Return the inverse of a 3×3 matrix with rows a, b, c; its columns are `b × c / (a · b × c)` and cyclic."""
    xp = namespace(a)
    columns = cross(xp.roll(a, -1, axis=0), xp.roll(a, -2, axis=0))
    return columns.T / xp.sum(a[0] * columns[0])


def cross(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "*#batch 3"]:
    """Return `a × b` over the last axis, whose component `i + 2` is `a_i b_(i+1) − a_(i+1) b_i`, indices modulo 3."""
    xp = namespace(a, b)

    def following(v: Array) -> Array:
        return xp.concatenate([v[..., 1:], v[..., :1]], -1)

    return following(a * following(b) - following(a) * b)


def vee_of_skew_part(a: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return the vector of the antisymmetric part, `sk(A)^∨` with `sk(A) = (A − Aᵀ)/2`; inverse of `skew`."""
    xp = namespace(a)
    part = 0.5 * (a - xp.swapaxes(a, -1, -2))
    return xp.stack([part[..., 2, 1], part[..., 0, 2], part[..., 1, 0]], -1)


def exp_so3(phi: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation by the vector `phi` [rad]: `exp(S(φ)) = I + A S + B S²`, with `S² = φ φᵀ − θ² I`.

    `A = sin θ/θ` and `B = (1 − cos θ)/θ²` are even in θ, and thus smooth functions of `θ²`, also at zero.
    """
    xp = namespace(phi)
    square = xp.sum(phi * phi, -1)[..., None, None]
    a, b = _sinc_and_cosc(square)
    s = skew(phi)
    eye = xp.broadcast_to(xp.eye(3, dtype=phi.dtype), s.shape)
    return (1.0 - b * square) * eye + a * s + b * phi[..., :, None] * phi[..., None, :]


def _sinc_and_cosc(square: Array) -> tuple[Array, Array]:
    """Return `sin θ/θ` and `(1 − cos θ)/θ²` as functions of `θ²`."""
    xp = namespace(square)
    is_small = square < 1e-2
    # `where` alone is not enough, since both branches are differentiated and d√u/du is infinite at 0.
    theta = xp.sqrt(xp.where(is_small, 1.0, square))
    half = xp.sin(0.5 * theta) / (0.5 * theta)
    u = square
    sinc = 1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0 * (1.0 - u / 110.0))))
    cosc = 0.5 * (1.0 - u / 12.0 * (1.0 - u / 30.0 * (1.0 - u / 56.0 * (1.0 - u / 90.0 * (1.0 - u / 132.0)))))
    return xp.where(is_small, sinc, xp.sin(theta) / theta), xp.where(is_small, cosc, 0.5 * half * half)


def axis_angle(axis: Float[Array, "*#batch 3"], angle: Float[Array, " *#batch"]) -> Float[Array, "*#batch 3 3"]:
    """Return the rotation about a unit axis by an angle [rad]."""
    xp = namespace(axis, angle)
    s, c = xp.sin(angle)[..., None, None], xp.cos(angle)[..., None, None]
    outer = axis[..., :, None] * axis[..., None, :]
    return c * xp.broadcast_to(xp.eye(3, dtype=axis.dtype), outer.shape) + s * skew(axis) + (1.0 - c) * outer


def safe_norm(v: Float[Array, "*batch _"]) -> Float[Array, " *batch"]:
    """Return the length over the last axis, with gradient zero for the zero vector."""
    xp = namespace(v)
    square = xp.sum(v * v, -1)
    is_zero = square == 0.0
    return xp.where(is_zero, 0.0, xp.sqrt(xp.where(is_zero, 1.0, square)))


def rotation_angle(r: Float[Array, "*batch 3 3"]) -> Float[Array, " *batch"]:
    """Return the angle of a rotation [rad], in [0, π]; accurate near both ends, since it avoids `acos`."""
    xp = namespace(r)
    return xp.arctan2(safe_norm(vee_of_skew_part(r)), 0.5 * (trace(r) - 1.0))


def log_so3(r: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return the rotation vector [rad] of a rotation by at most 180°, the inverse of `exp_so3`.

    At exactly 180° the axis has either sign.
    """
    xp = namespace(r)
    v = vee_of_skew_part(r)
    square, cosine = xp.sum(v * v, -1), 0.5 * (trace(r) - 1.0)
    # The antisymmetric part vanishes at 180°. Above 90° the axis k is that of (R + Rᵀ)/2 − cos θ I = (1 − cos θ) k kᵀ,
    # whose longest column has the greatest diagonal entry.
    is_large, eye = (cosine < 0.0)[..., None, None], xp.broadcast_to(xp.eye(3, dtype=r.dtype), r.shape)
    outer = xp.where(is_large, 0.5 * (r + xp.swapaxes(r, -1, -2)) - cosine[..., None, None] * eye, eye)
    longest = xp.argmax(xp.diagonal(outer, axis1=-2, axis2=-1), -1)
    column = xp.take_along_axis(outer, longest[..., None, None], -1)[..., 0]
    column = column * xp.where(xp.sum(column * v, -1, keepdims=True) < 0.0, -1.0, 1.0)
    axis = column / xp.sqrt(xp.sum(column * column, -1, keepdims=True))
    large = axis * xp.arctan2(xp.sum(axis * v, -1), cosine)[..., None]
    # For small θ, θ/sin θ = 1 + sin²θ/6 to the last bit.
    is_small = square < np.finfo(r.dtype).eps
    sine = xp.sqrt(xp.where(is_small, 1.0, square))
    factor = xp.where(is_small, 1.0 + square / 6.0, xp.arctan2(sine, cosine) / sine)
    return xp.where(is_large[..., 0], large, factor[..., None] * v)


def rotation_from_rpy(rpy: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return `Rz(yaw) Ry(pitch) Rx(roll)` for `rpy = (roll, pitch, yaw)` [rad]."""
    xp = namespace(rpy)
    (sr, sp, sy), (cr, cp, cy) = xp.moveaxis(xp.sin(rpy), -1, 0), xp.moveaxis(xp.cos(rpy), -1, 0)
    return xp.stack(
        [
            xp.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], -1),
            xp.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], -1),
            xp.stack([-sp, cp * sr, cp * cr], -1),
        ],
        -2,
    )


def rpy_from_rotation(r: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Return roll, pitch and yaw [rad] of a rotation, with pitch in [−π/2, π/2]; inverse of `rotation_from_rpy`.

    At gimbal lock (pitch within √ε of ±π/2) only the sum or difference of roll and yaw is defined, and roll is set to
    zero. All derivatives are finite.
    """
    xp = namespace(r)
    cos_pitch = safe_norm(xp.stack([r[..., 0, 0], r[..., 1, 0]], -1))
    pitch = xp.arctan2(-r[..., 2, 0], cos_pitch)
    # At gimbal lock rounding would change roll and yaw by as much as setting roll to zero changes the attitude.
    is_locked = cos_pitch < np.sqrt(np.finfo(r.dtype).eps)
    roll = xp.arctan2(xp.where(is_locked, 0.0, r[..., 2, 1]), xp.where(is_locked, 1.0, r[..., 2, 2]))
    sine, cosine = xp.where(is_locked, -r[..., 0, 1], r[..., 1, 0]), xp.where(is_locked, r[..., 1, 1], r[..., 0, 0])
    return xp.stack([roll, pitch, xp.arctan2(sine, cosine)], -1)


def project_to_so3(near: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the nearest rotation to a matrix close to one, by two Newton–Schulz steps `R ← R (3 I − RᵀR)/2`."""
    xp = namespace(near)
    r = near
    for _ in range(2):
        r = multiply(0.5 * r, 3.0 * xp.eye(3, dtype=r.dtype) - multiply(xp.swapaxes(r, -1, -2), r))
    return r


def nearest_rotation(near: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotations `U diag(1, 1, det UV) V` that have the least distance to matrices `U Σ V`, of NumPy.

    Unlike `project_to_so3` of any matrices; NaN where one holds NaN.
    """
    is_known = np.isfinite(near).all(axis=(-2, -1))[..., None, None]
    left, _, right = np.linalg.svd(np.where(is_known, near, np.eye(3)))
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.where(is_known, left @ right, np.nan)


def rotation_from_wxyz(wxyz: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Return the rotation of a quaternion `wxyz`, which is normalised first."""
    xp = namespace(wxyz)
    q = wxyz / xp.linalg.norm(wxyz, axis=-1, keepdims=True)
    w, v = q[..., 0, None, None], q[..., 1:]
    s = skew(v)
    rotation: Array = xp.eye(3, dtype=wxyz.dtype) + 2.0 * (w * s + multiply(s, s))
    return rotation


def wxyz_from_rotation(r: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """Return the quaternion `wxyz` of a rotation, with `w ≥ 0`.

    Of four expressions that each divide by one component, the one with the largest divisor is used.
    """
    xp = namespace(r)
    m = r
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    whole = trace(m)
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = xp.stack(
        [
            xp.stack([1.0 + whole, a, b, c], -1),
            xp.stack([a, 1.0 + 2.0 * xx - whole, xy, xz], -1),
            xp.stack([b, xy, 1.0 + 2.0 * yy - whole, yz], -1),
            xp.stack([c, xz, yz, 1.0 + 2.0 * zz - whole], -1),
        ],
        -2,
    )
    best = xp.argmax(xp.diagonal(rows, axis1=-2, axis2=-1), -1)
    q = xp.take_along_axis(rows, best[..., None, None], -2)[..., 0, :]
    q = q / xp.linalg.norm(q, axis=-1, keepdims=True)
    return xp.where(q[..., :1] < 0.0, -q, q)
