"""The predictive law against the Rust crate: its linearised dynamics, its QP, and its commands along a flight."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.control import tick
from jax_aero.control.command import DEGRADED, NOMINAL, PLAN_KEPT, PLAN_MISSING
from jax_aero.control.law.mpc.clearance import distances
from jax_aero.control.law.mpc.horizon import Target, horizon
from jax_aero.control.law.mpc.model import linearise
from jax_aero.control.measurement import UsedMeasurement
from jax_aero.identify import states_of
from jax_aero.io import scenario_config
from jax_aero.robot import load_robot
from jax_aero.types import Setpoint, State

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-9
COUNT = 6
DISTANCES = ("distance", "distance_by_joint")
STATUS = {"Nominal": NOMINAL, "Degraded": DEGRADED, "PlanKept": PLAN_KEPT, "PlanMissing": PLAN_MISSING}
LOSS = {"jet": "l_arm_jet", "kind": "off", "time": 0.2}
OVERFLOW = (0.0, -1e4, 0.0)
"""A wind in which predictions overflow, so that no plan has an answer [m/s]."""


def flight(overrides=None):
    table = rust.load_config(ROOT / "configs/experiments/test2_mpc.toml", overrides)
    config = scenario_config(table)
    robot = load_robot(config.robot)
    return table, robot, tick.momentum_controller(config, robot)


def random_ticks(robot, knots):
    rng = np.random.default_rng(5)
    n, limits = robot.n_joints, np.asarray(robot.joint_limits)
    for index in range(COUNT):
        rotation = rust.rotation_from_wxyz(rng.normal(size=4))
        velocity = rng.normal(scale=1.0 + index % 3, size=6 + n)
        state = State(rng.normal(scale=5.0, size=3), rotation, rng.uniform(*limits.T), velocity)
        thrust, wind = rng.uniform(10.0, 150.0, 4), rng.normal(scale=8.0, size=3)
        yield state, thrust, wind, rng.uniform(*limits.T), 0.3 * rng.normal(size=n), rng.normal(size=(knots, 6, 3))


def test_linearised_dynamics_and_qp(agree):
    """Derivatives by automatic differentiation against the crate's own, with weighted forces; then H and g."""
    table, robot, params = flight({"disturbances.aero_estimate": {"drag": 0.8, "normal": 1.3, "links": {"head": 2.0}}})
    mpc, gains = params.mpc, (params.torque.kd, params.torque.kp)

    @jax.jit
    def evaluate(state, thrust, wind, posture, integral, targets):
        none, no = jnp.zeros(()), jnp.zeros((), bool)
        used = UsedMeasurement(none, state, thrust, wind, none.astype(int), 0.0 * thrust, none, none, no)
        model = params.model(robot, used)
        linear = linearise(robot, params.aero, mpc.structure.air, mpc.structure.joints, state, thrust, wind)
        target = Target(*jnp.moveaxis(targets, 1, 0))
        limits = params.limits(robot)
        args = linear, used, model, limits, posture, integral, target
        ahead = horizon(mpc, mpc.weights, gains, robot, *args)
        found = distances(robot, mpc.clearance, mpc.structure.joints, state.joint_position)
        return linear._asdict() | {"h": ahead.h, "g": ahead.g} | dict(zip(DISTANCES, found, strict=True))

    for state, thrust, wind, posture, integral, targets in random_ticks(robot, len(mpc.structure.durations)):
        controller = rust.Controller(table)
        started = controller.start(rust.State(*state), thrust, wind)
        controller.state = started.with_posture_control(posture, np.eye(3), integral)
        controller.tick(rust.State(*state), thrust, wind)
        theirs = controller.prediction(integral, targets)
        ours = jax.device_get(evaluate(state, thrust, wind, posture, integral, targets))
        for name, value in ours.items():
            agree(name, value, theirs[name], TOLERANCE)


def test_tick_towards_a_given_setpoint(agree):
    """It moves on at constant velocity while the plan looks ahead."""
    table, robot, params = flight()
    rng = np.random.default_rng(6)
    start = table["simulator"]["initial"]
    upright, joints = np.diag([-1.0, -1.0, 1.0]), np.array(start["joint_position"])
    state = State(np.array(start["base_position"]), upright, joints, 0.1 * rng.normal(size=6 + robot.n_joints))
    thrust, wind = np.array(start["thrust"]), np.array([1.0, -5.0, 0.0])
    near = rust.rotation_from_wxyz(np.array([1.0, *(0.01 * rng.normal(size=3))]))
    given = Setpoint(
        state.base_position + 0.02 * rng.normal(size=3),
        *(0.1 * rng.normal(size=(3, 3))),
        state.base_rotation @ near,
        *(0.1 * rng.normal(size=(3, 3))),
    )

    @jax.jit
    def evaluate(state, thrust, wind, given):
        memory = tick.init(params, robot, state)
        return tick.tick(params, robot, memory, jnp.zeros(()), state, thrust, wind, given)[1]

    command = jax.device_get(evaluate(state, thrust, wind, given))
    theirs = rust.Controller(table).tick(rust.State(*state), thrust, wind, 0.0, rust.Setpoint(**given._asdict()))
    assert command.status == STATUS[theirs.status] == NOMINAL
    agree("thrust_rate", command.thrust_rate, theirs.thrust_rate, TOLERANCE)
    agree("joint_velocity", command.joint_velocity, theirs.joint_velocity_command, TOLERANCE)


@pytest.fixture(scope="module")
def flown(x64):
    """A flight that loses an engine, and the commands along it in any wind."""
    accepted = dict.fromkeys(
        ("position", "rotation", "velocity", "angular_velocity", "joint_position", "joint_velocity"), 1e9
    )
    overrides = {"controller.channels.jump": accepted, "controller.channels.greatest.wind": 1e9}
    overrides |= {"disturbances.jets": {"failure": LOSS}, "simulator.duration": 0.6}
    table, robot, params = flight(overrides | {"wind.ramp_start": -1.0, "wind.ramp_end": 0.3})
    log = rust.fly(table).log
    states = states_of(log, slice(None))

    @jax.jit
    def along(wind):
        def one(memory, measurement):
            memory, command, _ = tick.tick(params, robot, memory, *measurement)
            return memory, command

        start = tick.init(params, robot, jax.tree.map(lambda leaf: leaf[0], states))
        return jax.lax.scan(one, start, (log["time"], states, log["thrust"], wind))[1]

    return table, log, states, lambda wind: jax.device_get(along(wind))


def test_ticks_before_and_after_the_loss_of_an_engine(flown, agree):
    """Plans, their inputs in between, the set-points ahead, and the search for thrusts and joints at their limits."""
    _, log, _, along = flown
    command = along(log["wind"])
    is_lost = log["degraded_modes"] > 0
    assert not is_lost[:20].any()
    assert is_lost[-30:].all()
    assert np.array_equal(command.status, np.where(is_lost, DEGRADED, NOMINAL))
    agree("flight: thrust_rate", command.thrust_rate, log["thrust_rate"], TOLERANCE)
    agree("flight: joint_velocity_command", command.joint_velocity, log["joint_velocity_command"], TOLERANCE)
    agree("flight: joint_torque", command.joint_torque, log["joint_torque"], TOLERANCE)


def test_ticks_without_a_new_plan(flown, agree):
    """Without an answer the last plan is followed for a fifth of a second; then the momentum QP decides."""
    table, log, states, along = flown
    time, wind = log["time"], log["wind"].copy()
    wind[(time > 0.075) & (time < 0.4)] = OVERFLOW
    command = along(wind)
    controller, statuses = rust.Controller(table), []
    for i in range(len(time)):
        state = rust.State(*(np.asarray(part[i]) for part in states))
        theirs = controller.tick(state, log["thrust"][i], wind[i], time[i])
        statuses.append(STATUS[theirs.status])
        agree("thrust_rate", command.thrust_rate[i], theirs.thrust_rate, TOLERANCE)
        agree("joint_velocity", command.joint_velocity[i], theirs.joint_velocity_command, TOLERANCE)
    assert command.status.tolist() == statuses
    assert {NOMINAL, PLAN_KEPT, PLAN_MISSING, DEGRADED} == set(statuses)
