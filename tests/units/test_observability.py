"""What the momentum rate can say of sensors: its derivatives by thrusts, wind and joints, from the symbolic model."""

import casadi as ca
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.places import ROBOT
from jax_aero.symbolic import MomentumModel, load_robot

WEIGHTS = np.repeat([0.04, 1.0], 3)[:, None]
"""Forces in moments, as in M106 [m]."""


@pytest.fixture(scope="module")
def derivatives():
    """Derivatives of the hovering robot's momentum rate by thrusts (6, 4), a side wind of 10 m/s (6, 3) and joints."""
    model = MomentumModel(load_robot(ROBOT), rust.load_aero("axisymmetric_corrected"))
    variables = model.thrust, model.wind, model.tree.joint_position
    by = [ca.jacobian(model.momentum_rate, variable) for variable in variables]
    initial = rust.load_config("test2_observer")["simulator"]["initial"]
    state = np.zeros(3), np.eye(3), np.array(initial["joint_position"]), np.zeros(29)
    found = model.function("maps", by)(*state, np.array(initial["thrust"]), [0.0, -10.0, 0.0])
    return [np.array(derivative.full()) for derivative in found]


def test_a_wrench_that_is_in_no_model_hides_every_thrust_error(derivatives):
    """Six rates for ten unknowns: of an error in any thrust nothing is left that another wrench does not explain."""
    everything = np.hstack([derivatives[0], np.eye(6)])
    assert everything.shape[1] - np.linalg.matrix_rank(everything) == 4


def test_one_combination_of_thrust_errors_is_a_wind(derivatives):
    """Seven unknowns in six rates; but with 25 N it is a wind of 60 m/s, which no gust is."""
    together = np.hstack(derivatives[:2])
    assert np.linalg.matrix_rank(together) == 6
    hidden = np.linalg.svd(together)[2][-1]
    assert np.linalg.norm(hidden[4:]) * 25.0 / np.abs(hidden[:4]).max() > 60.0


@pytest.mark.parametrize(("error", "least"), [([1, 1, 1, 1], 0.95), ([1, 0, 0, 0], 0.6), ([0, 0, 1, 0], 0.7)])
def test_no_horizontal_wind_looks_like_a_thrust_error(derivatives, error, least):
    """What is left of an error where the wind explains as much of it as it can."""
    wrench, wind = WEIGHTS * (derivatives[0] @ np.array(error, float)[:, None]), WEIGHTS * derivatives[1][:, :2]
    left = wrench - wind @ np.linalg.lstsq(wind, wrench)[0]
    assert np.linalg.norm(left) > least * np.linalg.norm(wrench)


def test_offsets_of_encoders_are_a_wrench(derivatives):
    """A wrench that is in no model explains any offset of joints; without one, six rates leave 17 of 23 unknown."""
    offsets = derivatives[2]  # [N/rad, N m/rad]
    assert offsets.shape == (6, 23)
    assert np.linalg.matrix_rank(np.hstack([offsets, np.eye(6)])) == 6
    assert offsets.shape[1] - np.linalg.matrix_rank(offsets) == 17
    together = offsets @ np.full(23, np.radians(3.0))
    assert np.linalg.norm(together[:3]) > 30.0
