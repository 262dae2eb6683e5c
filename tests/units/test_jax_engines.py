"""Thrusts of engines that run end at their least."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.base import places
from jax_aero.body import jets
from jax_aero.body.robot import load_robot
from jax_aero.body.shaft import wanted_speed

pytestmark = pytest.mark.usefixtures("x64")

ROBOT = load_robot(places.ROBOT)
MODELS = jets.engines(ROBOT, ROBOT.jets.engines[:2])
STEP = 0.01


def test_thrusts_end_at_the_least_of_running_engines():
    """Those of ideal and of identified engines; a prediction leaves an engine that has stopped where it is."""
    least, start = jnp.array([40.0, 50.0]), jnp.array([42.0, 51.0])
    model = jets.SecondOrderJets(MODELS, least, False)
    for dynamics in (jets.IdealJets(least), model):
        now, lowest = dynamics.start(start), start
        for _ in range(100):
            now = dynamics.advance(now, jnp.array([-300.0, -300.0]), jnp.array(STEP))
            lowest = jnp.minimum(lowest, now.thrust)
            assert (now.thrust_rate[now.thrust == least] >= 0.0).all()
        np.testing.assert_array_equal(lowest, least)
    thrust = jnp.array([20.0, 20.0, 11.0, 4.0, 4.0, 0.0, -3.0])
    rate = jnp.array([-10.0, -30.0, 4.0, -2.0, 2.0, -2.0, -2.0])
    found, after = jets.predict_thrust(thrust, jnp.zeros(7), rate, jnp.array(0.5), jnp.full(7, 11.0), None)
    np.testing.assert_array_equal(after, rate)
    np.testing.assert_array_equal(found, [15.0, 11.0, 13.0, 4.0, 5.0, 0.0, 0.0])


def test_an_input_beyond_the_top_of_its_parabola_has_the_throttle_of_the_top():
    bent = MODELS._replace(b_uu=jnp.array([-0.004, 0.0]))
    top = jnp.array([125.0, 0.0])  # where 1 + 2 b_uu u is zero
    for v in (62.5, 63.0, 1000.0):
        found = jets.throttle_from_input(bent, jnp.array([v, v]))
        np.testing.assert_allclose(found, top.at[1].set(v), rtol=1e-7)


def test_a_shaft_is_asked_for_speeds_from_idle_to_full():
    shaft = SimpleNamespace(idle=0.3)
    np.testing.assert_allclose(
        wanted_speed(shaft, jnp.array([-1.0, 0.0, 50.0, 100.0, 101.0])), [0.3, 0.3, 0.65, 1.0, 1.0]
    )


def test_a_throttle_below_the_least_is_the_least():
    idling, thrust = MODELS._replace(throttle_min=jnp.full(2, 10.0)), jnp.array([60.0, 70.0])
    below, least = jnp.full(2, 5.0), jnp.full(2, 10.0)

    def estimated(engines, throttle):
        model = jets.SecondOrderJets(engines, jnp.zeros(2), False)
        return jets.update_ekf(model, model.start(thrust)[2], thrust, throttle, STEP)[1]

    for found in (lambda e, throttle: jets.thrust_acceleration(e, thrust, 0.0 * thrust, throttle), estimated):
        np.testing.assert_array_equal(found(idling, below), found(MODELS, least))
        assert (found(MODELS, least) != found(MODELS, below)).any()
    np.testing.assert_array_equal(jets.steady_throttle(idling, jnp.zeros(2)), least)


def test_the_filter_of_an_engine_is_that_of_its_linearised_dynamics():
    """Kalman's equations, with the derivatives of `T̈` by automatic differentiation."""
    model, throttle, measured = (
        jets.SecondOrderJets(MODELS, jnp.zeros(2), False),
        jnp.array([40.0, 60.0]),
        jnp.array([64.0, 65.0]),
    )
    before = jets.EngineState(
        throttle, jnp.array([[60.0, 5.0], [70.0, -8.0]]), jnp.tile(jnp.array([[4.0, 0.5], [0.5, 9.0]]), (2, 1, 1))
    )
    estimate, covariance = jets.update_ekf(model, before, measured, throttle, STEP)
    for j in range(2):
        p, c = before.covariance[j], jnp.array([1.0, 0.0])
        gain = p @ c / (c @ p @ c + jets.R / STEP)
        x, p = before.estimate[j] + gain * (measured[j] - before.estimate[j, 0]), p - jnp.outer(gain, c @ p)

        def flow(x, j=j):
            at = jnp.tile(x, (2, 1))
            return jnp.stack([x[1], jets.thrust_acceleration(MODELS, at[:, 0], at[:, 1], throttle)[j]])

        phi = jnp.eye(2) + STEP * jax.jacfwd(flow)(x)
        np.testing.assert_allclose(estimate[j], x + STEP * flow(x), rtol=1e-12)
        np.testing.assert_allclose(covariance[j], phi @ p @ phi.T + STEP * jnp.asarray(jets.Q), rtol=1e-12)
