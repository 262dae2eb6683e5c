"""The state estimator in JAX against the crate's: the same measurements and commands, read by both."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import aero_model
from jax_aero.control import Measurement
from jax_aero.control.guard import estimator
from jax_aero.control.guard.estimator import Order
from jax_aero.control.measurement import Reading
from jax_aero.control.modes import MODES
from jax_aero.control.tick import momentum_controller, replace_command
from jax_aero.identify import states_of
from jax_aero.io import scenario_config
from jax_aero.robot import load_robot
from jax_aero.sim import sensors
from jax_aero.spatial import rotation_from_wxyz
from jax_aero.types import State

EXPERIMENT = Path(__file__).resolve().parents[2] / "configs" / "experiments" / "test2_sensors.toml"
BOTH = {"controller.wind_observer": {}}
STEP = jnp.asarray(0.01)
WIND = {"profile": "ramp", "velocity": [3.0, -9.0, 1.0], "ramp_start": 0.0, "ramp_end": 0.5}


def test_both_estimate_the_same_state(x64, measured):
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
    time_step, ticks = jnp.asarray(config.simulator.time_step), len(flown["time"])
    errors = sensors.sensors(config.simulator.sensors, time_step, ticks - 1, 23, 4)
    settings = estimator.estimator(config.controller.estimator, time_step)
    air = aero_model(config.controller.aero, robot)

    truth = Reading(states_of(flown.log, slice(None)), flown["thrust"])
    names = ("joint_torque", "thrust_rate", "unmodelled_wrench", "measured_wind")
    orders = Order(*(flown[name] for name in names), np.full(ticks, time_step))
    rows = jax.tree.map(jnp.asarray, (truth, orders, np.arange(ticks)))

    def tick(state, row):
        seeing, estimating = state
        now, order, count = row
        seeing, said = sensors.read(errors, seeing, now, count)
        estimating, found, _ = estimator.update(settings, robot, air, estimating, said, time_step)
        return (seeing, estimator.command(estimating, order)), found

    first = jax.tree.map(lambda x: x[0], rows[0])
    begun = estimator.start(settings, first.state, len(first.thrust))
    (_, last), found = jax.lax.scan(tick, (sensors.start(errors, first), begun), rows)
    np.testing.assert_allclose(last.then.gyro_bias, bias, rtol=0, atol=0.03)
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
    settings = estimator.estimator(config.controller.estimator, STEP)
    state = State(jnp.array([0.1, 0.2, 0.8]), jnp.eye(3), jnp.full(robot.n_joints, 0.1), jnp.zeros(6 + robot.n_joints))
    first = Reading(state, jnp.full(4, 100.0))
    started = estimator.start(settings, state, 4)
    begun, _, _ = jax.jit(lambda reading: estimator.update(settings, robot, air, started, reading, STEP))(first)
    said = Reading(state._replace(base_position=state.base_position + 0.01), first.thrust)
    lost = said._replace(thrust=said.thrust.at[2].set(absurd))
    run = jax.jit(lambda reading: estimator.update(settings, robot, air, begun, reading, STEP)[1])
    expected, found = run(said), run(lost)
    assert np.all(np.isfinite(found.thrust))
    assert np.all(np.isfinite(expected.thrust))
    for name in State._fields:
        difference = np.max(np.abs(getattr(found.state, name) - getattr(expected.state, name)))
        measured(name, difference, 1e-12, because="the same operations")


@pytest.fixture(scope="module")
def alone(x64):
    """A controller with both estimators, its compiled step, its robot, and readings of one that hardly moves, without
    joint velocities."""
    config = scenario_config(rust.load_config(EXPERIMENT, BOTH))
    robot, first = load_robot(config.robot), config.simulator.initial
    rng = np.random.default_rng(7)

    def reading(tick):
        state = State(
            jnp.asarray(first.base_position),
            jnp.diag(jnp.array([-1.0, -1.0, 1.0])),
            jnp.asarray(first.joint_position + 1e-6 * rng.standard_normal(robot.n_joints)),
            jnp.asarray(np.append(0.01 * rng.standard_normal(6), np.full(robot.n_joints, np.nan))),
        )
        return Measurement(jnp.asarray(0.01 * tick), state, jnp.asarray(first.thrust), jnp.array([0.0, 9.0, 0.0]))

    controller = momentum_controller(config, robot)
    return controller, jax.jit(controller.step), robot, [reading(tick) for tick in range(10)]


def test_both_find_a_wrong_thrust_sensor_in_the_same_tick(alone):
    """Thrusts follow their commands, a sensor is off from the third tick on, and the momentum shows nothing of it."""
    controller, step, robot, readings = alone
    crate = rust.Controller(rust.load_config(EXPERIMENT, BOTH))
    memory, thrust = controller.init(robot, readings[0].state), readings[0].thrust
    modes = []
    for tick in range(20):
        off = jnp.array([60.0 if tick >= 3 else 0.0, 0.0, 0.0, 0.0])
        reading = readings[tick % 10]._replace(time=jnp.asarray(0.01 * tick), thrust=thrust + off)
        memory, command = step(robot, memory, reading)
        theirs = crate.tick(reading.state, reading.thrust, reading.wind, float(reading.time))
        modes.append((int(command.degraded_modes), sum(MODES[name] for name in theirs.degraded_modes)))
        thrust = thrust + 0.01 * jnp.asarray(theirs.thrust_rate)
    assert all(ours == theirs for ours, theirs in modes), modes
    found = [ours for ours, _ in modes].index(MODES["thrust_modelled"])
    # Lags of 0.04 and 0.02 s until 12 N of 60 N, of which the estimator follows a tenth a tick, and 0.03 s.
    assert 8 <= found <= 14, modes
    assert modes[-1][0] == MODES["thrust_modelled"]


def test_both_follow_ticks_of_every_length_and_begin_anew_after_a_pause(alone, measured):
    """Ticks of one to three time steps, a pause of 0.3 s, and a clock that runs back."""
    controller, step, robot, readings = alone
    crate = rust.Controller(rust.load_config(EXPERIMENT, BOTH))
    memory, thrust = controller.init(robot, readings[0].state), readings[0].thrust
    steps = [0.01, 0.02, 0.03, 0.01, 0.02, 0.3, 0.01, 0.01, 0.02, -1.0, 0.01, 0.01, 0.03]
    restarts, commands = [], []
    for tick, time in enumerate(np.cumsum([1.5, *steps])):
        reading = readings[tick % 10]._replace(time=jnp.asarray(float(time)), thrust=thrust)
        memory, command = step(robot, memory, reading)
        theirs = crate.tick(reading.state, reading.thrust, reading.wind, float(time))
        assert int(command.degraded_modes) == sum(MODES[name] for name in theirs.degraded_modes)
        commands.append([np.append(x.thrust_rate, x.joint_torque) for x in (command, theirs)])
        restarts.append(int(memory.estimator.ticks) == 1)
        thrust = thrust + 0.01 * jnp.asarray(theirs.thrust_rate)
    assert np.flatnonzero(restarts).tolist() == [0, 6]
    ours, crates = np.swapaxes(commands, 0, 1)
    assert np.abs(crates).max() > 10.0
    because = "joints whose model runs away by a factor of 1.5 and more a tick, held by measurements"
    measured("commands [N/s, N m]", np.abs(ours - crates).max(), 1e-6, because=because)


def test_a_controller_alone_has_both_estimators_in_its_state(alone):
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
        assert not np.array_equal(after.wind.wind, before.wind.wind)
        np.testing.assert_array_equal(given.wind, before.wind.wind)
        np.testing.assert_allclose(command.terms.wind_std, before.wind.std, rtol=1e-14)
        np.testing.assert_array_equal(after.estimator.orders.torque[0], command.joint_torque)
    _, again = run(states[5], readings[5:])
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(commands[5:]), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_what_is_not_accepted_is_not_followed(alone):
    controller, step, robot, readings = alone

    def run(error):
        memory, modes = controller.init(robot, readings[0].state), []
        for tick, reading in enumerate(readings):
            place = reading.state.base_position + (error if tick == 5 else 0.0)
            given = reading._replace(state=reading.state._replace(base_position=place))
            memory, command = step(robot, memory, given)
            modes.append(int(command.degraded_modes))
        return memory.estimator.then.reading.state.base_position, modes

    right, nothing = run(0.0)
    found, modes = run(1.0)
    assert nothing == [0] * 10
    assert modes == [0] * 5 + [MODES["position_predicted"]] + [0] * 4
    # A tick without a correction, of an estimate that moves at millimetres per second.
    assert np.max(np.abs(found - right)) < 1e-3


def test_what_is_predicted_follows_a_command_that_is_replaced(alone, measured):
    controller, _, robot, readings = alone

    @jax.jit
    def replace(more):
        memory, command = controller.step(robot, controller.init(robot, readings[0].state), readings[0])
        rates, torque = command.thrust_rate + more, command.joint_torque + more
        return replace_command(memory, command, command.terms, rates, torque)

    (without, own), (memory, command) = (jax.device_get(replace(more)) for more in (0.0, 0.5))
    orders, known = memory.estimator.orders, memory.channels
    np.testing.assert_array_equal(orders.torque[0], command.joint_torque)
    np.testing.assert_array_equal(orders.thrust_rate[0], command.thrust_rate)
    np.testing.assert_array_equal(known.thrust_rate, command.thrust_rate)
    # M Δν̇ = S Δτ
    force = np.zeros(6 + robot.n_joints)
    force[6:] = command.joint_torque - own.joint_torque
    assert np.abs(force).max() > 0.1
    found = command.terms.dynamics.mass_matrix @ (known.acceleration - without.channels.acceleration)
    measured("force of an action [N, N m]", np.abs(found - force).max(), 1e-8)
