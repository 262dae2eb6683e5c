"""Thrusts of engines that run end at their least."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.base import places
from jax_aero.body import jets
from jax_aero.body.robot import load_robot

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
