"""Engines that fail and sensors that are wrong, each law by itself; the crate's are in `rust/core/tests/engines.rs`."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import jets
from jax_aero.control.guard import engines
from jax_aero.control.law.attitude import MomentumGains
from jax_aero.control.tick import momentum_controller
from jax_aero.io import scenario_config
from jax_aero.robot import load_robot
from jax_aero.rust import load_config

pytestmark = pytest.mark.usefixtures("x64")

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
STEP = 0.01
ROBOT = load_robot(CONFIGS / "robot" / "ironcub_mk1.toml")
MODELS = jets.engines(ROBOT, ROBOT.jets.engines[:2])
LIMITS = engines.EngineLimits(jnp.array(0.5), jnp.array(15.0), jnp.array(0.05), MODELS, None)
NONE = MomentumGains(*(jnp.zeros(3),) * 2, *(jnp.zeros(()),) * 3)
DESCENT = engines.Descent(jnp.array(30.0), NONE, jnp.zeros(1), jnp.zeros(1))
A_T = jnp.asarray(np.random.default_rng(1).normal(size=(6, 2)))
THRUST = jnp.array([100.0, 80.0])


def update(state, innovation, thrust=THRUST, sensor_error=(0.0, 0.0), *, has_momentum=True, share=1.0, command=0.0):
    """After a tick; the residual is that of sensors that are wrong by `sensor_error` [N]."""
    residual = -A_T @ jnp.asarray(sensor_error, float)
    known = jnp.full(2, command), jnp.array(True), A_T, residual, jnp.array(has_momentum), jnp.full(2, share)
    return engines.update(LIMITS, state, jnp.array(STEP), thrust, jnp.asarray(innovation, float), *known)


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
        measured(f"tick {tick}", np.abs(state.late - late[None]).max(), 1e-12)


@pytest.mark.parametrize("size", [30.0, -30.0])
@pytest.mark.parametrize(("share", "is_sensor"), [(0.51, True), (0.49, False)])
def test_the_momentum_shows_wrong_sensors(size, share, is_sensor):
    """Sensors that are wrong by `d` put `−Σ a d` into the momentum: from half of that on it is they, all at once."""
    tick = 7
    state, found = engines.start(THRUST), size * np.exp(-(tick - 1) * STEP / 0.5)
    for now in range(1, tick + 1):
        shown = share * late_part(now) * size
        state, is_wrong, deviation = update(state, [size, size] if now == 1 else [0.0, 0.0], THRUST, [shown, shown])
    np.testing.assert_array_equal(is_wrong, [is_sensor] * 2)
    np.testing.assert_array_equal(state.is_limited, [not is_sensor] * 2)
    if is_sensor:
        assert abs(float(deviation[1]) - found) < 1e-9
        # They are no longer accepted, and say nothing about their engines.
        assert not any(np.any(x) for x in (state.deviation, state.estimated, state.late, state.suspected))


def late_part(tick):
    """Lagged part of a step that is forgotten, after `tick` ticks."""
    residual, late = -np.expm1(-STEP / 0.02), 0.0
    for now in range(tick):
        late += residual * (np.exp(-now * STEP / 0.5) - late)
    return late


def test_an_engine_that_is_limited_has_no_wrong_sensor():
    state = engines.start(THRUST)
    for tick in range(1, 9):
        state, _, _ = update(state, [-30.0, 0.0] if tick == 1 else [0.0, 0.0])
    assert bool(state.is_limited[0])
    state, is_wrong, _ = update(state, [0.0, 0.0], THRUST, (-30.0, 0.0))
    assert not is_wrong.any()


@pytest.mark.parametrize("lags", [True, False])
def test_an_engine_that_follows_as_fast_as_it_can_is_not_limited(lags):
    """100 N/s at once are more than its throttle gives: it lags by more than the limit, and is not blamed."""
    start = jnp.array([60.0, 60.0])
    model = jets.SecondOrderJets(
        MODELS, jnp.zeros(2), jnp.array(150.0), jnp.array(0.0), jnp.eye(2), jnp.array(1.0), False, None, jnp.eye(2)
    )
    dynamics = model if lags else jets.IdealJets(jnp.zeros(2))
    state, now, farthest = engines.start(start), dynamics.start(start), 0.0
    advance = jax.jit(lambda now, command: dynamics.advance(now, command, STEP))
    for tick in range(150):
        command = jnp.full(2, 100.0 if tick % 100 < 50 else -100.0)
        before, now = now.thrust, advance(now, command)
        innovation = now.thrust - (before + STEP * command)
        state, is_wrong, _ = update(state, innovation, now.thrust, command=command[0])
        assert not (is_wrong | state.is_limited).any()
        farthest = max(farthest, float(jnp.abs(state.deviation).max()))
    assert (farthest > 15.0) == lags


def test_thrusts_end_at_the_least_of_running_engines():
    """Those of ideal and of identified engines; a prediction leaves an engine that has stopped where it is."""
    least, start = jnp.array([40.0, 50.0]), jnp.array([42.0, 51.0])
    model = jets.SecondOrderJets(
        MODELS, least, jnp.array(150.0), jnp.array(0.0), jnp.eye(2), jnp.array(1.0), False, None, jnp.eye(2)
    )
    for dynamics in (jets.IdealJets(least), model):
        now, lowest = dynamics.start(start), start
        for _ in range(100):
            now = dynamics.advance(now, jnp.array([-300.0, -300.0]), jnp.array(STEP))
            lowest = jnp.minimum(lowest, now.thrust)
            assert (now.thrust_rate[now.thrust == least] >= 0.0).all()
        np.testing.assert_array_equal(lowest, least)
    thrust = jnp.array([20.0, 20.0, 11.0, 4.0, 4.0, 0.0, -3.0])
    rate = jnp.array([-10.0, -30.0, 4.0, -2.0, 2.0, -2.0, -2.0])
    found = jets.predict_thrust(thrust, rate, jnp.array(0.5), jnp.full(7, 11.0))
    np.testing.assert_array_equal(found, [15.0, 11.0, 13.0, 4.0, 5.0, 0.0, 0.0])


def test_the_least_thrust_of_the_law_is_that_of_a_running_engine():
    """Also of an engine that was found to reach less; one that stopped has what is left of it."""
    robot = load_robot(CONFIGS / "robot" / "ironcub_mk3.toml")
    controller = momentum_controller(scenario_config(load_config(CONFIGS / "experiments" / "mk3_hover.toml")), robot)
    usual = controller.limits(robot)
    np.testing.assert_array_equal(usual.thrust_least, 4 * [11.0])
    state = engines.start(jnp.zeros(4))._replace(
        least=jnp.array([0.0, 0.0, 0.0, 60.0]), greatest=jnp.array([jnp.inf, 80.0, 2.0, 90.0])
    )
    limits, _ = engines.limit(LIMITS, state, usual)
    np.testing.assert_array_equal(limits.thrust_least, [11.0, 11.0, 2.0, 60.0])
    np.testing.assert_array_equal(limits.thrust_greatest, [227.0, 80.0, 2.0, 90.0])


def test_nothing_is_judged_without_a_momentum():
    """Lags and confirmation begin anew when it is back."""
    state = engines.start(THRUST)
    for tick in range(10):
        state, is_wrong, _ = update(state, [-40.0 if tick == 0 else 0.0, 0.0], has_momentum=False)
        assert not state.is_limited.any()
        assert not is_wrong.any()
        assert not state.late.any()
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
