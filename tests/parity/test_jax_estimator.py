"""The state estimator in JAX against the crate's: the same measurements and commands, read by both."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import aero_model
from jax_aero.control import estimator
from jax_aero.control.estimator import Order, Reading
from jax_aero.io import scenario_config
from jax_aero.robot import load_robot
from jax_aero.sim import sensors
from jax_aero.spatial import rotation_from_wxyz
from jax_aero.types import State

EXPERIMENT = Path(__file__).resolve().parents[2] / "configs" / "experiments" / "test2_sensors.toml"
WIND = {"profile": "ramp", "velocity": [3.0, -9.0, 1.0], "ramp_start": 0.0, "ramp_end": 0.5}


def test_both_estimate_the_same_state(x64, measured):
    """Truth and commands are those of a flight of the crate, whose log has what its estimator gave the controller."""
    table = rust.load_config(EXPERIMENT, {"simulator.duration": 0.5})
    table["wind"] = WIND
    flown = rust.fly(table)
    config, robot = scenario_config(table), load_robot(table["robot"])
    time_step, ticks = jnp.asarray(config.simulator.time_step), len(flown["time"])
    errors = sensors.sensors(config.simulator.sensors, time_step, ticks - 1, 4)
    settings = estimator.estimator(config.controller.estimator, aero_model(config.controller.aero, robot), time_step)

    rotations = jax.vmap(rotation_from_wxyz)(jnp.asarray(flown["base_quaternion"]))
    velocity = np.hstack([flown["base_velocity"], flown["joint_velocity"]])
    truth = Reading(State(flown["base_position"], rotations, flown["joint_position"], velocity), flown["thrust"])
    orders = Order(*(flown[name] for name in ("joint_torque", "thrust_rate", "unmodelled_wrench", "measured_wind")))
    rows = jax.tree.map(jnp.asarray, (truth, orders, np.arange(ticks)))

    def tick(state, row):
        seeing, estimating = state
        now, order, count = row
        seeing, said = sensors.read(errors, seeing, now, count)
        estimating, found = estimator.update(settings, robot, estimating, said)
        return (seeing, estimator.command(estimating, order)), found

    first = jax.tree.map(lambda x: x[0], rows[0])
    begun = sensors.start(errors, first)
    _, said = sensors.read(errors, begun, first, jnp.array(0))
    _, found = jax.lax.scan(tick, (begun, estimator.start(settings, said)), rows)
    because = "fifty ticks of a model whose joints run away by a factor of 1.5 in each, held by measurements"
    for name, ours in {
        "measured_base_position": found.state.base_position,
        "measured_base_velocity": found.state.velocity[:, :6],
        "measured_joint_velocity": found.state.velocity[:, 6:],
        "measured_thrust": found.thrust,
    }.items():
        measured(name, np.max(np.abs(ours - flown[name])), 1e-9, because=because)
    turned = found.state.base_rotation - jax.vmap(rotation_from_wxyz)(jnp.asarray(flown["measured_base_quaternion"]))
    measured("measured_base_quaternion", np.max(np.abs(turned)), 1e-9, because=because)


@pytest.mark.parametrize("absurd", [np.nan, np.inf, 1e300])
def test_a_lost_number_corrects_nothing_and_the_others_do(absurd, x64, measured):
    table = rust.load_config(EXPERIMENT)
    config, robot = scenario_config(table), load_robot(table["robot"])
    air = aero_model(config.controller.aero, robot)
    settings = estimator.estimator(config.controller.estimator, air, jnp.asarray(config.simulator.time_step))
    state = State(jnp.array([0.1, 0.2, 0.8]), jnp.eye(3), jnp.full(robot.n_joints, 0.1), jnp.zeros(6 + robot.n_joints))
    first = Reading(state, jnp.full(4, 100.0))
    begun = estimator.start(settings, first)
    said = Reading(state._replace(base_position=state.base_position + 0.01), first.thrust)
    lost = said._replace(thrust=said.thrust.at[2].set(absurd))
    run = jax.jit(lambda reading: estimator.update(settings, robot, begun, reading)[1])
    expected, found = run(said), run(lost)
    assert np.isnan(found.thrust[2])
    assert np.all(np.isfinite(expected.thrust))
    for name in State._fields:
        difference = np.max(np.abs(getattr(found.state, name) - getattr(expected.state, name)))
        measured(name, difference, 1e-12, because="the same operations")
