"""Thrusts of engines that run end at their least."""

from __future__ import annotations

from types import SimpleNamespace

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
