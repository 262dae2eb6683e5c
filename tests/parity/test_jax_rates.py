"""Torques computed more often than the law decides: JAX against the Rust crate, tick by tick and in closed loop."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.control import Command
from jax_aero.control.law.between import JointMeasurement, JointsBetween, joint_tracker, update
from jax_aero.control.tick import momentum_controller
from jax_aero.io import scenario_config
from jax_aero.robot import load_robot
from jax_aero.types import State, pytree

STEPS = 5
TWO_RATES = {"controller.torque.steps": STEPS, "simulator.substeps": STEPS}


@pytest.mark.usefixtures("x64")
def test_ticks_of_the_torques(agree):
    """Joints that are measured, are missing, are beyond the limits, or jump."""
    jumps = {"controller.channels.jump.joint_position": 0.3, "controller.channels.jump.joint_velocity": 1.0}
    table = rust.load_config("test2_observer", TWO_RATES | jumps)
    config, theirs = scenario_config(table), rust.Controller(table)
    robot = load_robot(config.robot)
    params = momentum_controller(config, robot)
    initial = config.simulator.initial
    rest = np.asarray(initial.joint_position)
    upright = rust.rotation_from_wxyz(np.array([0.0, 0.0, 0.0, 1.0]))
    thrust, wind, draw = np.asarray(initial.thrust), np.zeros(3), np.random.default_rng(3)

    step, init = jax.jit(params.step), jax.jit(params.init)
    step_torques = jax.jit(params.step_torques)
    memory = None
    for tick in range(3):
        posture = rest + 0.01 * draw.normal(size=rest.size)
        velocity = np.concatenate([0.1 * draw.normal(size=6), 0.1 * draw.normal(size=rest.size)])
        state = State(np.array([0.0, 0.0, 1.0]), upright, posture, velocity)
        memory = init(robot, state) if memory is None else memory
        expected = theirs.tick(rust.State(*state), thrust, wind, 0.01 * tick)
        measured = sim.Measurement(jnp.array(0.01 * tick), state, thrust, wind)
        memory, command = step(robot, memory, measured)
        agree("joint_torque", command.joint_torque, expected.joint_torque, 1e-9)
        for part in range(1, STEPS):
            at = posture + 0.001 * part * velocity[6:]
            speed = velocity[6:] + 0.05 * draw.normal(size=rest.size)
            at[part], speed[2 * part], at[3 * part], speed[3 * part] = np.nan, np.nan, 1e300, 5.0
            expected_torque, status = theirs.tick_torques(at, speed)
            memory, torque = step_torques(robot, memory, command, JointMeasurement(at, speed), jnp.array(part))
            assert status == expected.status
            agree("joint_torque between", torque, expected_torque, 1e-9)


FLIGHTS = {
    # Two sub-steps for each tick of the torques; joints that are not measured in between.
    "test2": {
        "controller.torque.steps": 3,
        "simulator.substeps": 6,
        "disturbances.outages": [
            {"channel": "joints", "start": 0.104, "duration": 0.05, "kind": "missing"},
            {"channel": "thrust", "start": 0.304, "duration": 0.05, "kind": "frozen"},
        ],
    },
    # Encoders whose velocities are those of the ticks, an estimator, and a known latency.
    "test2_sensors": TWO_RATES | {"controller.estimator.latency": {"torque": 0.008, "thrust": 0.025}},
}


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight_at_two_rates(name, measured):
    """Commands are late, and some are lost: each torque of a tick has its own delay."""
    step = 0.01 / FLIGHTS[name]["simulator.substeps"]
    actuation = {"thrust_delay": 6 * step, "torque_delay": step, "jitter": step, "drop": 0.1, "seed": 3}
    changes = {**FLIGHTS[name], "simulator.duration": 0.4, "simulator.actuation": actuation}
    table = rust.load_config(name, changes)
    theirs, ours = rust.fly(table), sim.fly(table)
    assert ours.outcome == theirs.outcome == "completed"
    at_one_rate = rust.fly(rust.load_config(name, {**changes, "controller.torque.steps": 1}))
    assert np.abs(at_one_rate.log["joint_position"] - theirs.log["joint_position"]).max() > 1e-4
    for signal in ("base_position", "joint_position", "thrust", "joint_torque", "unmodelled_wrench"):
        scale = max(1.0, np.abs(theirs.log[signal]).max())
        difference = np.abs(ours.log[signal] - theirs.log[signal]).max() / scale
        measured(signal, difference, 1e-9, because="rounding, as in flights at one rate")


def test_what_is_not_measured_has_no_derivative(x64):
    tracker = joint_tracker(scenario_config(rust.load_config("test2", TWO_RATES)).controller, 0.01)
    now = jnp.array([1.0, 2.0])
    before = JointsBetween(now, now, now, now, now, jnp.array(True))

    def position(at):
        return update(tracker, before, JointMeasurement(jnp.stack([at, jnp.nan]), now)).position

    np.testing.assert_array_equal(jax.jacobian(position)(jnp.array(1.5)), [1.0, 0.0])


@pytest.mark.parametrize("key", ["fuel", "motors"])
def test_what_this_engine_has_not_is_refused(key):
    config = scenario_config(rust.load_config("test2"))
    simulator = msgspec.structs.replace(config.simulator, **{key: object()})
    with pytest.raises(ValueError, match=rf"`simulator\.{key}` is given; expected none"):
        sim.prepare(msgspec.structs.replace(config, simulator=simulator), dtype=np.float32)


@pytest.mark.usefixtures("x64")
def test_a_controller_of_one_rate_is_refused():
    @pytree
    class Still:
        def init(self, *_):
            return ()

        def step(self, _, state, measurement):
            return state, Command(0.0 * measurement.thrust, 0.0 * measurement.state.velocity[6:])

    with pytest.raises(ValueError, match=r"controller.torque.steps` is 5; expected 1 .*step_torques"):
        sim.prepare(rust.load_config("test2", TWO_RATES), controller=Still())
