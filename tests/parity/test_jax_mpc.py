"""The predictive law against the Rust crate: its linearised dynamics, its QP, and its commands along a flight."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.control import tick
from jax_aero.control.law.plan import no_plan
from jax_aero.control.measurement import Measurement
from jax_aero.control.mpc.clearance import distances
from jax_aero.control.mpc.horizon import Horizon, Target, horizon
from jax_aero.control.mpc.law import _find_beyond
from jax_aero.control.mpc.model import linearise
from jax_aero.control.preview import Preview
from jax_aero.sim import prepare, step
from jax_aero.types import Setpoint, State
from jax_aero.verify.flight import states_of

pytestmark = pytest.mark.usefixtures("x64")

TOLERANCE = 1e-9
COUNT = 6
DISTANCES = ("distance", "distance_by_joint")
ROUNDED = 1e-13
"""Of distances: some hundred roundings. A derivative through the nearest points, which `TINY` moves, is 1e-11 off."""
OVERFLOW = (-299.0, -299.0, -299.0)
"""The strongest wind that is accepted: with tripled areas predictions overflow, so that no plan has an answer [m/s]."""


def flight(changes=None):
    table = rust.load_config("test2_mpc", changes)
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
        targets, wrenches = rng.normal(size=(knots, 6, 3)), rng.normal(scale=20.0, size=(knots, 6))
        yield state, thrust, wind, rng.uniform(*limits.T), 0.3 * rng.normal(size=n), targets, wrenches


def test_linearised_dynamics_and_qp(agree):
    """Derivatives by automatic differentiation against the crate's own, with weighted forces; then H and g."""
    table, robot, params = flight(
        {"disturbances.aero_estimate": {"drag": 0.8, "normal": 1.3, "links": {"head": 2.0}, "drag_of": {"chest": 0.6}}}
    )
    mpc, gains = params.mpc, (params.torque.kd, params.torque.kp)

    @jax.jit
    def evaluate(state, thrust, wind, posture, targets, wrenches):
        now = Measurement(jnp.zeros(()), state, thrust, wind)
        model = params.model(robot, now)
        linear = linearise(robot, params.aero, mpc.structure.air, mpc.structure.joints, state, thrust, wind)
        target = Target(*jnp.moveaxis(targets, 1, 0))
        ahead = horizon(mpc, params.engines, gains, robot, linear, now, model, posture, target, wrenches)
        found = distances(robot, mpc.clearance, mpc.structure.joints, state.joint_position)
        return linear._asdict() | {"h": ahead.h, "g": ahead.g} | dict(zip(DISTANCES, found, strict=True))

    for state, thrust, wind, posture, integral, *ahead in random_ticks(robot, len(mpc.structure.durations)):
        controller = rust.Controller(table)
        started = controller.start(rust.State(*state), thrust, wind)
        controller.state = started.with_posture_control(posture, np.eye(3), integral)
        controller.tick(rust.State(*state), thrust, wind)
        theirs = controller.prediction(*ahead)
        ours = jax.device_get(evaluate(state, thrust, wind, posture, *ahead))
        for name, value in ours.items():
            agree(name, value, theirs[name], ROUNDED if name in DISTANCES else TOLERANCE)


@pytest.mark.parametrize("until", [0.0, 0.3, 1.2])
def test_tick_towards_a_given_setpoint(agree, until):
    """What follows it is given until some time; then it moves on at constant velocity while the plan looks ahead."""
    table, robot, params = flight()
    rng = np.random.default_rng(6)
    start = table["simulator"]["initial"]
    upright, joints = np.diag([-1.0, -1.0, 1.0]), np.array(start["joint_position"])
    state = State(np.array(start["base_position"]), upright, joints, 0.1 * rng.normal(size=6 + robot.n_joints))
    thrust, wind = np.array(start["thrust"]), np.array([1.0, -5.0, 0.0])
    near = rust.rotation_from_wxyz(np.array([1.0, *(0.01 * rng.normal(size=3))]))

    def some():
        com = state.base_position + 0.02 * rng.normal(size=3), *(0.1 * rng.normal(size=(3, 3)))
        return Setpoint(*com, state.base_rotation @ near, *(0.1 * rng.normal(size=(3, 3))))

    given, times = some(), until * np.array([0.1, 0.45, 1.0])
    later = [some() for _ in times]
    stacked = jax.tree.map(lambda *parts: np.stack(parts), *later)
    ahead = Preview(setpoints=(times, stacked) if until else None)

    @jax.jit
    def evaluate(state, thrust, wind, given, preview):
        memory = tick.init(params, robot, state)
        return tick.tick(params, robot, memory, jnp.zeros(()), state, thrust, wind, given, preview)[1]

    command = jax.device_get(evaluate(state, thrust, wind, given, ahead))
    given, *later = (rust.Setpoint(**one._asdict()) for one in (given, *later))
    known = rust.Preview(list(zip(times, later, strict=True)) if until else [])
    theirs = rust.Controller(table).tick(rust.State(*state), thrust, wind, 0.0, given, preview=known)
    assert command.degraded_modes == 0
    assert theirs.degraded_modes == []
    agree("thrust_rate", command.thrust_rate, theirs.thrust_rate, TOLERANCE)
    agree("joint_velocity", command.joint_velocity, theirs.joint_velocity_command, TOLERANCE)


def test_a_flight_with_a_preview_of_the_wind(fly_both):
    """Sensors, prediction and commands of a flight into a gust, in closed loop, with a latency that is compensated."""
    gust = {"profile": "ramp", "velocity": [3.0, -12.0, 0.0], "ramp_start": 0.1, "ramp_end": 0.4}
    changes = {"simulator.duration": 0.3, "simulator.sensors": {"wind_preview": 0.5}, "wind": gust}
    changes |= {"controller.estimator": {"latency": {"torque": 0.02, "thrust": 0.02}}}
    changes |= {"simulator.actuation": {"torque_delay": 0.02, "thrust_delay": 0.02}}
    seen = rust.load_config("test2_mpc", changes)
    unseen = rust.load_config("test2_mpc", changes | {"simulator.sensors": {}})
    expected, _ = fly_both(seen)
    assert np.max(np.abs(rust.fly(unseen)["thrust_rate"] - expected["thrust_rate"])) > 1.0


@pytest.fixture(scope="module")
def flown(x64):
    """A flight that climbs as an engine stops, which nothing finds, and the commands along it in any wind."""
    failure = {"jet": "l_arm_jet", "kind": "off", "time": 0.2}
    changes = {"disturbances.jets": {"failure": failure}, "simulator.duration": 0.6}
    changes |= {"controller.fault_detection": {}, "controller.channels.jump": False}
    changes |= {"disturbances.aero_estimate.scale": 3.0, "mission.up": [[0.55, 17.0]]}
    table, robot, params = flight(changes | {"wind.ramp_start": -1.0, "wind.ramp_end": 0.3})
    log = rust.fly(table).log
    states = states_of(log)

    @jax.jit
    def along(wind):
        def one(memory, measurement):
            memory, command, _ = tick.tick(params, robot, memory, *measurement)
            return memory, command

        start = tick.init(params, robot, jax.tree.map(lambda leaf: leaf[0], states))
        return jax.lax.scan(one, start, (log["time"], states, log["thrust"], wind))[1]

    return table, log, states, lambda wind: jax.device_get(along(wind))


def test_ticks_before_and_after_an_engine_stops(flown, agree):
    """Plans, their inputs in between, the set-points ahead, and the search for thrusts and joints at their limits."""
    _, log, _, along = flown
    command = along(log["wind"])
    assert not log["degraded_modes"].any()
    assert not np.any(command.degraded_modes)
    agree("flight: thrust_rate", command.thrust_rate, log["thrust_rate"], TOLERANCE)
    agree("flight: joint_velocity_command", command.joint_velocity, log["joint_velocity_command"], TOLERANCE)
    agree("flight: joint_torque", command.joint_torque, log["joint_torque"], TOLERANCE)


def test_ticks_without_a_new_plan(flown, agree):
    """Without an answer the last plan is followed for a fifth of a second; then the momentum QP decides."""
    table, log, states, along = flown
    time, wind = log["time"], log["wind"].copy()
    wind[(time > 0.075) & (time < 0.4)] = OVERFLOW
    command = along(wind)
    controller, modes = rust.Controller(table), []
    for i in range(len(time)):
        state = rust.State(*(np.asarray(part[i]) for part in states))
        theirs = controller.tick(state, log["thrust"][i], wind[i], time[i])
        modes.append(sum(rust.MODES[name] for name in theirs.degraded_modes))
        agree("thrust_rate", command.thrust_rate[i], theirs.thrust_rate, TOLERANCE)
        agree("joint_velocity", command.joint_velocity[i], theirs.joint_velocity_command, TOLERANCE)
    assert command.degraded_modes.tolist() == modes
    assert {0, rust.MODES["plan_kept"], rust.MODES["plan_missing"]} == set(modes)


def test_the_least_cost_on_the_way_is_that_of_many_points(x64):
    """Of random costs, in which ways leave limits below and above."""
    rng, shares = np.random.default_rng(0), np.linspace(0.0, 1.0, 20_001)
    # Three knots with a jet of three inputs and two joints of two; three distances.
    of_knot, inputs = 6, 7
    values = 3 * of_knot
    for _ in range(20):
        factor = rng.normal(size=(inputs, inputs))
        by_rates, by_commands, by_joints = (rng.normal(size=size) for size in ((3, 1, 3), (3, 2, 2), (3, 2)))
        by_inputs = np.zeros((3, of_knot, inputs))
        by_inputs[:, :1, :3] = by_rates
        for joint in range(2):
            by_inputs[:, 1 + joint, 3 + joint :: 2] = by_commands[:, joint]
        by_inputs[:, 3:] = by_joints @ by_inputs[:, 1:3]
        by_inputs = by_inputs.reshape(values, inputs)
        h, g, weight = factor @ factor.T, rng.normal(size=inputs), rng.uniform(1.0, 50.0, values)
        free, start, end = rng.normal(size=values), rng.normal(size=inputs), rng.normal(size=inputs)
        least, greatest = free - rng.uniform(0.2, 2.0, values), free + rng.uniform(0.2, 2.0, values)
        parts = map(jnp.asarray, (h, g, by_rates, by_commands, by_joints, free, least, greatest, weight))
        ahead = Horizon(*parts, None)
        np.testing.assert_allclose(ahead.changes(jnp.asarray(start)), by_inputs @ start, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(ahead.slope(jnp.asarray(free)), free @ by_inputs, rtol=1e-13, atol=1e-13)
        found = float(ahead.least_on_way(jnp.asarray(start), jnp.asarray(end)))
        at = start + shares[:, None] * (end - start)
        beyond = free + at @ by_inputs.T
        beyond = beyond - np.clip(beyond, least, greatest)
        cost = 0.5 * np.einsum("si,ij,sj->s", at, h, at) + at @ g + 0.5 * beyond**2 @ weight
        assert abs(found - shares[np.argmin(cost)]) <= 1.0001 * shares[1]


def strict(seed: int) -> Horizon:
    """Return a random cost of 4 knots and 3 jets, whose limits are narrow and weigh much, beside an idle joint."""
    rng, knots, jets = np.random.default_rng(seed), 4, 3
    n = knots * jets
    factor, g = rng.normal(size=(n, n)), 3.0 * rng.normal(size=n)
    own = np.zeros((knots, jets, knots))
    for knot in range(knots):
        for jet in range(jets):
            own[knot, jet, : knot + 1] = rng.uniform(0.5, 2.0, knot + 1) * rng.choice([-1, 1], knot + 1)
    free = rng.normal(size=n)
    least = free - rng.uniform(-1.0, 1.0, n)
    greatest, weight = least + rng.uniform(0.2, 1.0, n), 10.0 ** rng.uniform(0.0, 4.0, n)
    h = np.eye(n + 1)
    h[:n, :n] = 0.05 * (factor @ factor.T + np.eye(n))

    def with_joint(values, of_joint):
        return np.append(values.reshape(knots, jets), np.full((knots, 1), of_joint), axis=1).ravel()

    limits = (with_joint(part, of) for part, of in ((free, 0.0), (least, -np.inf), (greatest, np.inf), (weight, 1.0)))
    none = np.zeros((knots, 1, 1)), np.zeros((0, 1))
    parts = h, np.append(g, 0.0), own, *none, *limits
    return Horizon(*map(jnp.asarray, parts), None)


def test_a_plan_is_the_least_of_its_cost_by_its_search_on_the_way(x64, monkeypatch):
    """From one answer to the next the values beyond their limits would be the same again and again."""
    cases = [strict(seed) for seed in (25, 53, 336)]
    bound = jnp.full(cases[0].g.size, 1e6)

    def search(ahead: Horizon):
        found = _find_beyond(ahead, (-bound, bound), no_plan(bound.size, 3, jnp.float64))
        return found.is_found, found.answer.x

    find = jax.jit(search)
    for ahead in cases:
        is_found, x = jax.device_get(find(ahead))
        at = ahead.free + ahead.changes(x)
        excess = ahead.weight * (at - jnp.clip(at, ahead.least, ahead.greatest))
        assert is_found
        # Rounding of numbers below ten times weights.
        assert np.abs(ahead.h @ x + ahead.g + ahead.slope(excess)).max() < 1e-13 * ahead.weight.max()
    monkeypatch.setattr(Horizon, "least_on_way", lambda *_: jnp.ones(()))
    find = jax.jit(lambda ahead: search(ahead)[0])
    assert not any(find(ahead) for ahead in cases)


@pytest.mark.slow
def test_flights_of_a_batch_that_began_at_other_ticks_fly_as_each_alone(x64):
    """In each tick of the batch a plan is due in one flight or none."""
    scenario, start = prepare(rust.load_config("robot"))
    alone, batch = jax.jit(step), jax.jit(jax.vmap(step, in_axes=(None, 0, 0)))
    states, rows = [start], []
    for number in range(11):
        state, row = alone(scenario, states[-1], jnp.asarray(number, jnp.int32))
        states.append(state)
        rows.append(row)
    ticks = np.arange(4)
    together = jax.tree.map(lambda *parts: jnp.stack(parts), *(states[first] for first in ticks))
    for later in range(7):
        together, row = batch(scenario, together, jnp.asarray(ticks + later, jnp.int32))
        for member, first in enumerate(ticks):
            expected = rows[first + later]
            assert row["degraded_modes"][member] == expected["degraded_modes"]
            for name in ("thrust_rate", "joint_velocity_command", "joint_torque"):
                # Rounding of sums in another order, enlarged by the solutions of two QPs.
                np.testing.assert_allclose(row[name][member], expected[name], rtol=1e-8, atol=1e-8, err_msg=name)
