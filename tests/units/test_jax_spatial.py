"""Laws of rotations in JAX, and their agreement with scipy."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jax_aero.body import spatial

pytestmark = pytest.mark.usefixtures("x64")

RNG = np.random.default_rng(8)
ANGLES = np.array([0.0, 1e-12, 1e-6, 0.05, 0.1, 0.2, 1.0, 3.1])
VECTORS = np.concatenate([ANGLES[:, None] * np.array([0.6, 0.0, -0.8]), RNG.normal(size=(20, 3))])


def test_exponential_and_angle():
    ours = spatial.exp_so3(jnp.asarray(VECTORS))
    assert np.allclose(ours, Rotation.from_rotvec(VECTORS).as_matrix(), rtol=0, atol=1e-15)
    angles = np.linalg.norm(VECTORS, axis=1)
    assert np.allclose(spatial.rotation_angle(ours), np.abs((angles + np.pi) % (2 * np.pi) - np.pi), rtol=0, atol=1e-14)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_logarithm_and_its_derivative(dtype):
    """Inverse of the exponential to 8 roundings, for small and large turns; finite derivatives, at the ends too."""
    angles = np.array([0.0, 1e-30, 1e-9, 3e-4, 0.1, 1.5, 3.0, 3.14], dtype)
    vectors = jnp.asarray(angles[:, None] * np.array([0.6, 0.0, -0.8], dtype))
    rotations = spatial.exp_so3(vectors)
    found = spatial.log_so3(rotations)
    assert found.dtype == dtype
    assert np.allclose(found, vectors, rtol=0, atol=8 * np.finfo(dtype).eps * np.pi)
    assert np.array_equal(spatial.log_so3(jnp.eye(3, dtype=dtype)), np.zeros(3))
    slopes = jax.vmap(jax.jacrev(spatial.log_so3))(rotations)
    assert np.all(np.isfinite(slopes))
    assert np.allclose(slopes[0], jax.jacrev(spatial.vee_of_skew_part)(rotations[0]), rtol=0, atol=1e-7)
    for signs in ([1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]):
        half_turn = jnp.diag(jnp.array(signs, dtype))
        assert np.allclose(spatial.log_so3(half_turn), np.pi * np.maximum(signs, 0.0), rtol=0, atol=np.finfo(dtype).eps)
        assert np.all(np.isfinite(jax.jacrev(spatial.log_so3)(half_turn)))


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_roll_pitch_yaw_at_gimbal_lock(pitch, measured):
    """Roll is zero there; the three still name the rotation, and derivatives stay finite."""
    exact = jnp.array([[0.0, 0.0, np.sign(pitch)], [0.0, 1.0, 0.0], [-np.sign(pitch), 0.0, 0.0]])
    rounded = spatial.rotation_from_rpy(jnp.array([0.0, 0.0, 1.1])) @ spatial.rotation_from_rpy(
        jnp.array([0.3, pitch, -0.2])
    )
    for rotation in (exact, rounded):
        rpy, slopes = spatial.rpy_from_rotation(rotation), jax.jacrev(spatial.rpy_from_rotation)(rotation)
        measured("pitch", abs(rpy[1] - pitch), 1e-15)
        assert rpy[0] == 0.0
        measured("rotation", np.abs(spatial.rotation_from_rpy(rpy) - rotation).max(), 1e-15)
        assert np.all(np.isfinite(slopes))


def test_skew_cross_and_products():
    a, b = RNG.normal(size=(2, 10, 3))
    m, n = RNG.normal(size=(2, 10, 3, 3))
    assert np.allclose(spatial.cross(jnp.asarray(a), jnp.asarray(b)), np.cross(a, b))
    assert np.allclose(spatial.skew(jnp.asarray(a)) @ b[..., None], np.cross(a, b)[..., None])
    assert np.allclose(spatial.vee_of_skew_part(spatial.skew(jnp.asarray(a))), a)
    assert np.allclose(spatial.multiply(jnp.asarray(m), jnp.asarray(n)), m @ n)
    assert np.allclose(spatial.rotate_back(jnp.asarray(m), jnp.asarray(a)), np.einsum("kji,kj->ki", m, a))


def test_projection_to_rotations():
    near = Rotation.random(10, random_state=2).as_matrix() + 1e-4 * RNG.normal(size=(10, 3, 3))
    projected = np.asarray(spatial.project_to_so3(jnp.asarray(near)))
    assert np.allclose(np.swapaxes(projected, 1, 2) @ projected, np.eye(3), rtol=0, atol=1e-13)
