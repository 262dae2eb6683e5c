"""Engines that fail and sensors that are wrong, each law by itself; the crate's are in `rust/core/tests/engines.rs`."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.control import engines
from jax_aero.io import load_config, scenario_config
from jax_aero.robot import load_robot

pytestmark = pytest.mark.usefixtures("x64")

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
STEP = 0.01
LIMITS = engines.EngineLimits(jnp.array(0.5), jnp.array(15.0), jnp.array(0.05), None)
A_T = jnp.asarray(np.random.default_rng(1).normal(size=(6, 2)))
THRUST = jnp.array([100.0, 80.0])


def updated(state, innovation, thrust=THRUST, sensor_share=(0.0, 0.0), *, has_momentum=True):
    """After a tick; `sensor_share` of the deviations, engine by engine, is seen in the momentum as well."""
    deviation = np.exp(-STEP / 0.5) * np.asarray(state.deviation) + np.asarray(innovation)
    # The residual whose projections on the columns of A_T are those shares.
    residual = np.linalg.pinv(A_T.T) @ (-np.asarray(sensor_share) * deviation * np.sum(np.asarray(A_T) ** 2, axis=0))
    known = jnp.asarray(innovation), A_T, jnp.asarray(residual), jnp.array(has_momentum)
    return engines.update(LIMITS, state, jnp.array(STEP), thrust, *known)


def test_deviations_are_summed_and_forgotten(measured):
    state = engines.start(THRUST)
    for tick in range(1, 31):
        state, _, _ = updated(state, [0.3, -0.1])
        expected = np.array([0.3, -0.1]) * np.expm1(-tick * STEP / 0.5) / np.expm1(-STEP / 0.5)
        measured(f"tick {tick}", np.abs(state.deviation - expected).max(), 1e-13)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_thrust_that_is_not_reached_bounds_the_engine_after_its_confirmation(sign):
    """20 N at once are suspect for five ticks and then bound the thrust on their side; 14 N never do."""
    state = engines.start(THRUST)
    for tick in range(1, 21):
        state, is_wrong, _ = updated(state, [20.0 * sign, 14.0] if tick == 1 else [0.0, 0.0])
        assert not is_wrong.any()
        np.testing.assert_array_equal(state.is_limited, [tick > 5, False])
    expected = (100.0, np.inf) if sign > 0.0 else (0.0, 100.0)
    assert (float(state.least[0]), float(state.greatest[0])) == expected
    assert not state.is_lost(LIMITS).any()


def test_an_engine_whose_bounds_meet_is_lost():
    """One that keeps 80 N whatever is asked, and one that fades away."""
    state, fading = engines.start(THRUST), 100.0
    for tick in range(100):
        fading = max(fading - 2.0, 0.0)
        state, _, _ = updated(state, [-1.0 if tick < 50 else 1.0, -2.0], jnp.array([80.0, fading]))
    assert (float(state.least[0]), float(state.greatest[0])) == (80.0, 80.0)
    assert (float(state.least[1]), float(state.greatest[1])) == (0.0, 0.0)
    assert state.is_lost(LIMITS).all()


@pytest.mark.parametrize("size", [30.0, -30.0])
def test_the_momentum_shows_a_wrong_sensor(size):
    """A sensor that is wrong by `d` puts `−a d` into the momentum: from half of that on it is the sensor."""
    state = engines.start(THRUST)
    for tick in range(1, 7):
        state, is_wrong, deviation = updated(state, [size, size] if tick == 1 else [0.0, 0.0], THRUST, (0.45, 0.55))
        np.testing.assert_array_equal(is_wrong, [False, tick == 6])
    assert abs(float(deviation[1])) > 15.0
    # It is no longer accepted, and says nothing about its engine.
    assert (float(state.deviation[1]), float(state.suspected[1])) == (0.0, 0.0)
    np.testing.assert_array_equal(state.is_limited, [True, False])


def test_an_engine_that_is_limited_has_no_wrong_sensor():
    state = engines.start(THRUST)
    for tick in range(1, 7):
        state, _, _ = updated(state, [-30.0, 0.0] if tick == 1 else [0.0, 0.0])
    assert bool(state.is_limited[0])
    state, is_wrong, _ = updated(state, [0.0, 0.0], THRUST, (1.0, 0.0))
    assert not is_wrong.any()


def test_nothing_is_judged_without_a_momentum():
    """The confirmation begins anew when it is back."""
    state = engines.start(THRUST)
    for tick in range(10):
        state, is_wrong, _ = updated(state, [-30.0 if tick == 0 else 0.0, 0.0], has_momentum=False)
        assert not state.is_limited.any()
        assert not is_wrong.any()
    for tick in range(1, 7):
        state, _, _ = updated(state, [0.0, 0.0])
        np.testing.assert_array_equal(state.is_limited, [tick == 6, False])


def test_the_limits_of_a_descent_are_those_of_revolute_joints():
    """Degrees and newton metres are not those of sliding joints."""
    config = scenario_config(load_config(CONFIGS / "experiments" / "test2_observer.toml")).controller.engines
    robot = load_robot(CONFIGS / "robot" / "slider.toml")
    descent = engines.engine_limits(config, robot).descent
    slides = np.array(robot.joint_is_prismatic)
    assert slides.any()
    assert not slides.all()
    speed = np.deg2rad(config.descent.joint_velocity_max_deg)
    np.testing.assert_array_equal(descent.joint_velocity_max, np.where(slides, 0.0, speed))
    np.testing.assert_array_equal(descent.torque_rate_max, np.where(slides, 0.0, config.descent.torque_rate_max))
