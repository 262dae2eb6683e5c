"""Engines and drives in the controller: rates of thrusts that are predicted, friction that is compensated."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.jets import engines, predict_thrust
from jax_aero.body.robot import load_robot

pytestmark = pytest.mark.usefixtures("x64")


def test_predicted_rates_of_thrusts(agree):
    """Of 60 ticks whose measured thrusts jump: commands within and beyond what the throttles reach."""
    throttled = {"controller.jet_dynamics": "throttled", "simulator.jets": {"dynamics": "throttled"}}
    table = rust.load_config("test2_mpc", throttled)
    config, robot = scenario_config(table), load_robot(table["robot"])
    model, step, least = engines(robot, robot.jets.engines), jnp.array(0.01), robot.jets.thrust_min
    flight, rng = rust.Flight(table), np.random.default_rng(2)
    rate, rows = jnp.zeros(4), []
    for _ in range(60):
        given = flight.measurement
        flight.step(measurement=given._replace(thrust=np.asarray(given.thrust) + rng.uniform(-20.0, 20.0, 4)))
        seen = flight.last
        rows.append((rate, seen.estimates.thrust_rate))
        rate = predict_thrust(seen.estimates.thrust, rate, seen.thrust_rate, step, least, model)[1]
    ours, theirs = (np.stack(column) for column in zip(*rows, strict=True))
    agree("thrust rate", ours, theirs, 1e-10)
    assert config.controller.jet_dynamics == "throttled"
    assert np.abs(theirs).max() > 10.0


def test_predicted_thrusts_end_at_the_least_of_running_engines():
    robot = load_robot(rust.load_config("mk3_robot")["robot"])
    model, least = engines(robot, robot.jets.engines), robot.jets.thrust_min
    thrust, rate = jnp.asarray(least) + 1.0, jnp.full(4, -300.0)
    found, after = predict_thrust(thrust, rate, rate, jnp.array(0.01), least, model)
    np.testing.assert_array_equal(found, least)
    assert np.all(after > -300.0)  # the throttle cannot close any further
    stopped = predict_thrust(jnp.full(4, 5.0), jnp.full(4, -50.0), jnp.full(4, -50.0), jnp.array(0.01), least, model)[0]
    np.testing.assert_array_equal(stopped, 5.0)
