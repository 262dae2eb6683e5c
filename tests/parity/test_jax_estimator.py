"""The state estimator in JAX against the crate's: the same measurements and commands, read by both."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import aero_model
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.config import LatencyConfig
from jax_aero.control import Measurement
from jax_aero.control.estimate import estimator
from jax_aero.control.estimate.estimator import Order
from jax_aero.control.measurement import Reading
from jax_aero.control.tick import momentum_controller, replace_command
from jax_aero.sim import sensors
from jax_aero.types import State
from jax_aero.verify.flight import states_of

EXPERIMENT = "test2_sensors"
WIND = {"profile": "ramp", "velocity": [3.0, -9.0, 1.0], "ramp_start": 0.0, "ramp_end": 0.5}


def test_both_estimate_the_same_state(x64, agree_with_the_log):
    """Truth and commands are those of a flight of the crate, whose log has what its estimator gave the controller. The
    gyroscopes have a bias, which the estimator finds."""
    bias = [0.05, -0.04, 0.03]
    changes = {
        "simulator.duration": 0.5,
        "simulator.sensors.base_angular_velocity.bias": bias,
        "controller.estimator.gyro_bias": 0.1,
    }
    table = rust.load_config(EXPERIMENT, changes)
    table["wind"] = WIND
    flown = rust.fly(table)
    config, robot = scenario_config(table), load_robot(table["robot"])
    time_step, ticks = jnp.asarray(config.controller.time_step), len(flown["time"])
    errors = sensors.sensors(config.simulator.sensors, time_step, ticks - 1, 23, 4)
    settings = estimator.estimator(config.controller.estimator, time_step)
    known = estimator.EstimatorModel(robot, aero_model(config.controller.aero, robot), None)

    truth = Reading(states_of(flown.log), flown["thrust"])
    orders = Order(*(flown[name] for name in ("joint_torque", "thrust_rate", "unmodelled_wrench", "measured_wind")))
    rows = jax.tree.map(jnp.asarray, (truth, orders, np.arange(ticks)))

    def tick(state, row):
        seeing, estimating = state
        now, order, count = row
        seeing, said = sensors.read(errors, seeing, now, count)
        estimating, found, _ = estimator.update(settings, known, estimating, said)
        return (seeing, estimator.command(estimating, order)), found

    first = jax.tree.map(lambda x: x[0], rows[0])
    begun = estimator.start(settings, first.state, len(first.thrust), has_engines=False)
    (_, last), found = jax.lax.scan(tick, (errors.start(first), begun), rows)
    np.testing.assert_allclose(last.then.gyro_bias, bias, rtol=0, atol=0.03)
    because = "fifty ticks of a model whose joints run away by a factor of 1.5 in each, held by measurements"
    agree_with_the_log(found, flown, 1e-9, because)


@pytest.fixture(scope="module")
def alone(x64):
    """A controller with its estimator, its compiled step, its robot, and readings of one that hardly moves."""
    config = scenario_config(rust.load_config(EXPERIMENT))
    robot, first = load_robot(config.robot), config.simulator.initial
    rng = np.random.default_rng(7)

    def reading(tick):
        state = State(
            jnp.asarray(first.base_position),
            jnp.diag(jnp.array([-1.0, -1.0, 1.0])),
            jnp.asarray(first.joint_position + 1e-6 * rng.standard_normal(robot.n_joints)),
            jnp.asarray(np.append(0.01 * rng.standard_normal(6), np.zeros(robot.n_joints))),
        )
        return Measurement(jnp.asarray(0.01 * tick), state, jnp.asarray(first.thrust), jnp.array([0.0, 9.0, 0.0]))

    controller = momentum_controller(config, robot)
    return controller, jax.jit(controller.step), robot, [reading(tick) for tick in range(10)]


def test_a_controller_alone_has_its_estimator_in_its_state(alone):
    controller, step, robot, readings = alone

    def run(memory, readings):
        states, commands = [memory], []
        for reading in readings:
            memory, command = step(robot, memory, reading)
            states.append(jax.device_get(memory))
            commands.append(jax.device_get(command))
        return states, commands

    states, commands = run(controller.init(robot, readings[0].state), readings)
    assert [int(state.estimator.ticks) for state in states] == list(range(11))
    for before, after, command, reading in zip(states[:-1], states[1:], commands, readings, strict=True):
        given, is_first = command.terms.estimates, before.estimator.ticks == 0
        # The first estimate is the first measurement; joint velocities are found from positions.
        assert np.allclose(given.state.velocity[:6], reading.state.velocity[:6], rtol=1e-12) == is_first
        assert np.all(given.state.velocity[6:] == 0.0) == is_first
        assert command.degraded_modes == 0
        np.testing.assert_array_equal(after.estimator.orders.torque[0], command.joint_torque)
    _, again = run(states[5], readings[5:])
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(commands[5:]), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_the_estimator_follows_a_command_that_is_replaced(alone):
    controller, step, robot, readings = alone
    memory, command = step(robot, controller.init(robot, readings[0].state), readings[0])
    rates, torque = command.thrust_rate + 0.5, command.joint_torque + 0.5
    after, replaced = replace_command(memory, command, rates, torque)
    for found in (replaced.thrust_rate, after.estimator.orders.thrust_rate[0]):
        np.testing.assert_array_equal(found, rates)
    np.testing.assert_array_equal(replaced.joint_torque, torque)
    np.testing.assert_allclose(after.estimator.orders.torque[0], torque, rtol=1e-15)
    np.testing.assert_array_equal(after.joint_torque, command.joint_torque)


def test_latencies_are_whole_ticks_and_what_is_left():
    assert estimator.latency_in_ticks(LatencyConfig(torque=0.0125, thrust=0.0275), 0.01) == (1, (0.25, 1.75))


@pytest.mark.parametrize(
    ("part", "greatest"),
    [("position", 1e6), ("speed", 300.0), ("turning", 100.0), ("joints", 100.0), ("rates", 100.0), ("thrust", 10.0)],
)
def test_an_estimate_that_no_robot_can_have_is_not_used(x64, part, greatest):
    """The limits of `rust/core/src/control/measure/greatest.rs`: beyond each, what is measured is used."""
    robot = load_robot(rust.load_config(EXPERIMENT)["robot"])
    n = robot.n_joints

    def is_used(value: float) -> bool:
        position, velocity, joints, thrust = (
            np.zeros(3),
            np.zeros(6 + n),
            np.zeros(n),
            np.zeros(len(robot.jets.thrust_max)),
        )
        numbers = {"position": position, "speed": velocity[:3], "turning": velocity[3:6], "joints": joints}
        numbers |= {"rates": velocity[6:], "thrust": thrust}
        numbers[part][1] = -value * (robot.jets.thrust_max[1] if part == "thrust" else 1.0)
        return bool(estimator.is_possible(robot, Reading(State(position, np.eye(3), joints, velocity), thrust)))

    assert is_used(greatest)
    assert not is_used(greatest * (1.0 + 1e-9))
    assert not is_used(np.nan)
