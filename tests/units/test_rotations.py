"""Rotations in NumPy: each form from the others, and scipy's."""

import numpy as np
from scipy.spatial.transform import Rotation

from jax_aero.base.result import match_branch
from jax_aero.body import spatial


def test_quaternions_of_all_turns():
    """Also those half a turn from the identity, where the scalar part is zero."""
    rng = np.random.default_rng(0)
    wxyz = np.concatenate([rng.normal(size=(50, 4)), np.eye(4)])
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    turns = spatial.rotation_from_wxyz(wxyz)
    np.testing.assert_allclose(turns, Rotation.from_quat(wxyz, scalar_first=True).as_matrix(), atol=1e-15)
    found = spatial.wxyz_from_rotation(turns)
    np.testing.assert_allclose(np.abs(np.sum(found * wxyz, axis=1)), 1.0, atol=1e-14)
    assert (found[:, 0] >= 0.0).all()
    np.testing.assert_allclose(spatial.rotation_angle(turns), 2.0 * np.arccos(np.abs(wxyz[:, 0])), atol=1e-7)


def test_roll_pitch_and_yaw():
    rng = np.random.default_rng(1)
    rpy = rng.uniform([-3.0, -1.5, -3.0], [3.0, 1.5, 3.0], (4, 5, 3))
    turns = spatial.rotation_from_rpy(rpy)
    expected = Rotation.from_euler("xyz", rpy.reshape(-1, 3)).as_matrix().reshape(4, 5, 3, 3)
    np.testing.assert_allclose(turns, expected, atol=1e-15)
    np.testing.assert_allclose(spatial.rpy_from_rotation(turns), rpy, atol=1e-13)


def test_equivalent_rotations_are_compared_on_one_branch(agree):
    quaternions = np.array([[1.0, 0, 0, 0], [0.6, 0.8, 0, 0]])
    same = match_branch("base_quaternion", quaternions * np.array([[1.0], [-1.0]]), quaternions)
    np.testing.assert_array_equal(same, quaternions)
    angles = np.array([[0.1, 0.0, np.pi - 0.01]])
    turned = match_branch("base_rpy_setpoint", angles + np.array([[0.0, 0.0, -2.0 * np.pi]]), angles)
    agree("angles", turned, angles, 1e-15)
    assert match_branch("wind", angles, 0.0 * angles) is angles
