"""Engines that fail and sensors that are wrong, each law by itself; the crate's are in `rust/core/tests/engines.rs`."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.control.guard import engines
from jax_aero.control.law.attitude import MomentumGains
from jax_aero.io import scenario_config
from jax_aero.robot import load_robot
from jax_aero.rust import load_config

pytestmark = pytest.mark.usefixtures("x64")

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
STEP = 0.01
LIMITS = engines.EngineLimits(jnp.array(0.5), jnp.array(15.0), jnp.array(0.05), None)
NONE = MomentumGains(*(jnp.zeros(3),) * 2, *(jnp.zeros(()),) * 3)
DESCENT = engines.Descent(jnp.array(30.0), NONE, jnp.zeros(1), jnp.zeros(1))
A_T = jnp.asarray(np.random.default_rng(1).normal(size=(6, 2)))
THRUST = jnp.array([100.0, 80.0])


def update(state, innovation, thrust=THRUST, sensor_error=(0.0, 0.0), *, has_momentum=True, share=1.0):
    """After a tick; `sensor_error` is what the momentum says of the sensors, one by one [N]."""
    # The residual whose moments' projections on those of the columns of A_T are these errors.
    moments = np.asarray(A_T)[3:]
    moment = np.linalg.pinv(moments.T) @ (-np.asarray(sensor_error) * np.sum(moments**2, axis=0))
    # Forces say nothing.
    residual = jnp.concatenate([jnp.full(3, 1e3), jnp.asarray(moment)])
    known = jnp.asarray(innovation), A_T, residual, jnp.array(has_momentum), jnp.array(share)
    return engines.update(LIMITS, state, jnp.array(STEP), thrust, *known)


def test_deviations_are_summed_and_forgotten(measured):
    state = engines.start(THRUST)
    for tick in range(1, 31):
        state, _, _ = update(state, [0.3, -0.1])
        expected = np.array([0.3, -0.1]) * np.expm1(-tick * STEP / 0.5) / np.expm1(-STEP / 0.5)
        measured(f"tick {tick}", np.abs(state.deviation - expected).max(), 1e-13)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_thrust_that_is_not_reached_bounds_the_engine_after_its_confirmation(sign):
    """20 N at once are beyond 15 N, as late as the residual is, from the third tick on; five ticks later they count."""
    state = engines.start(THRUST)
    for tick in range(1, 21):
        state, is_wrong, _ = update(state, [20.0 * sign, 14.0] if tick == 1 else [0.0, 0.0])
        assert not is_wrong.any()
        np.testing.assert_array_equal(state.is_limited, [tick > 7, False])
    expected = (100.0, np.inf) if sign > 0.0 else (0.0, 100.0)
    assert (float(state.least[0]), float(state.greatest[0])) == expected
    assert not state.is_lost(DESCENT).any()


def test_an_engine_whose_bounds_are_close_together_is_lost():
    """One that keeps 80 N whatever is asked, and one that fades, once it gives less than 30 N."""
    state, fading = engines.start(THRUST), 100.0
    for tick in range(100):
        fading = max(fading - 2.0, 0.0)
        state, _, _ = update(state, [-1.0 if tick < 50 else 1.0, -2.0], jnp.array([80.0, fading]))
        is_stuck = bool(state.least[0] == state.greatest[0])
        np.testing.assert_array_equal(state.is_lost(DESCENT), [is_stuck, fading < 30.0])
    assert (float(state.least[0]), float(state.greatest[0])) == (80.0, 80.0)
    assert (float(state.least[1]), float(state.greatest[1])) == (0.0, 0.0)
    assert state.is_lost(DESCENT).all()


def test_a_deviation_is_as_late_as_the_momentum(measured):
    """Two lags, one with the share of the momentum, one with that of the residual."""
    state, estimated, late = engines.start(THRUST), np.zeros(2), np.zeros(2)
    steps = np.array([40.0, -1.0])
    for tick in range(1, 11):
        state, _, _ = update(state, steps if tick == 1 else [0.0, 0.0], share=0.2)
        deviation = steps * np.exp(-(tick - 1) * STEP / 0.5)
        estimated = estimated + 0.2 * (deviation - estimated)
        late = late - np.expm1(-STEP / 0.02) * (estimated - late)
        measured(f"tick {tick}", np.abs(state.late - late).max(), 1e-12)


@pytest.mark.parametrize("size", [30.0, -30.0])
def test_the_momentum_shows_a_wrong_sensor(size):
    """A sensor that is wrong by `d` puts `−a d` into the momentum: from half of that on it is the sensor."""
    state = engines.start(THRUST)
    for tick in range(1, 9):
        late = float(state.late[0])
        innovation = [size, size] if tick == 1 else [0.0, 0.0]
        state, is_wrong, deviation = update(state, innovation, THRUST, (0.4 * late, late))
        if is_wrong.any():
            break
    np.testing.assert_array_equal(is_wrong, [False, True])
    assert abs(float(deviation[1])) > 15.0
    # It is no longer accepted, and says nothing about its engine.
    assert [float(x[1]) for x in (state.deviation, state.estimated, state.late, state.suspected)] == [0.0] * 4
    np.testing.assert_array_equal(state.is_limited, [True, False])


def test_an_engine_that_is_limited_has_no_wrong_sensor():
    state = engines.start(THRUST)
    for tick in range(1, 9):
        state, _, _ = update(state, [-30.0, 0.0] if tick == 1 else [0.0, 0.0])
    assert bool(state.is_limited[0])
    state, is_wrong, _ = update(state, [0.0, 0.0], THRUST, (-30.0, 0.0))
    assert not is_wrong.any()


@pytest.mark.parametrize("arm", [0.0, -1e-17, 1e-17])
def test_of_a_jet_without_a_moment_no_sensor_is_wrong(arm):
    """Nothing is not a number on the way, and rounding errors of an arm say nothing."""
    state = engines.start(THRUST)
    for tick in range(1, 9):
        known = A_T.at[3:].set(arm), jnp.ones(6), jnp.array(True), jnp.array(1.0)
        state, is_wrong, _ = engines.update(
            LIMITS, state, jnp.array(STEP), THRUST, jnp.full(2, 30.0 if tick == 1 else 0.0), *known
        )
        assert not is_wrong.any()
    assert state.is_limited.all()


def test_nothing_is_judged_without_a_momentum():
    """Lags and confirmation begin anew when it is back."""
    state = engines.start(THRUST)
    for tick in range(10):
        state, is_wrong, _ = update(state, [-40.0 if tick == 0 else 0.0, 0.0], has_momentum=False)
        assert not state.is_limited.any()
        assert not is_wrong.any()
        assert float(state.late[0]) == 0.0
    for _ in range(6):
        state, _, _ = update(state, [0.0, 0.0])
        assert not state.is_limited.any()
    for _ in range(2):
        state, _, _ = update(state, [0.0, 0.0])
    np.testing.assert_array_equal(state.is_limited, [True, False])


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
