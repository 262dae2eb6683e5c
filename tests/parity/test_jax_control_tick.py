"""Every value of a controller tick against the Rust crate: far from any flight, along one, and when things fail."""

from __future__ import annotations

import copy
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.control import qp, tick
from jax_aero.types import Setpoint, State
from jax_aero.verify import SOLUTIONS
from jax_aero.verify.flight import states_of
from jax_aero.verify.ticks import crate_quantity, tick_quantities

pytestmark = pytest.mark.usefixtures("x64")

REPOSITORY = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-10
BATCH = 32


def random_samples(robot, count, seed=7):
    """Anywhere, fast, thrusts up to and at their limits, in a gale; one without wind, one where nothing moves."""
    rng = np.random.default_rng(seed)
    n, limits = robot.n_joints, np.asarray(robot.joint_limits)
    samples = []
    for index in range(count):
        rotation = rust.rotation_from_wxyz(rng.normal(size=4))
        state = State(
            rng.normal(scale=5, size=3), rotation, rng.uniform(*limits.T), rng.normal(scale=1.0 + index % 3, size=6 + n)
        )
        near = rotation @ rust.rotation_from_wxyz(np.array([1.0, *(0.2 * rng.normal(size=3))]))
        followed = Setpoint(
            state.base_position + 0.3 * rng.normal(size=3), *rng.normal(size=(3, 3)), near, *rng.normal(size=(3, 3))
        )
        memory = {
            "posture": rng.uniform(*limits.T),
            "inertia_0": np.diag(rng.uniform(0.5, 4.0, 3)),
            "velocity_error_integral": 0.3 * rng.normal(size=n),
        }
        thrust = rng.choice([0.0, 0.5, 80.0, 159.9, 160.0], size=4) if index % 4 == 0 else rng.uniform(10, 150, 4)
        samples.append((memory, state, thrust, rng.normal(scale=8.0, size=3), followed))
    memory, state, thrust, wind, followed = samples[0]
    samples[0] = (memory, state, thrust, 0.0 * wind, followed)
    samples[1] = (samples[1][0], state._replace(velocity=0.0 * state.velocity), thrust, 0.0 * wind, followed)
    return samples


def crate_tick(config, sample):
    memory, state, thrust, wind, followed = sample
    controller = rust.Controller(config)
    started = controller.start(rust.State(*state), thrust, wind)
    parts = (memory["posture"], memory["inertia_0"], memory["velocity_error_integral"])
    controller.state = started.with_posture_control(*(np.asarray(part, dtype=np.float64) for part in parts))
    return controller.tick(rust.State(*state), thrust, wind, 0.0, rust.Setpoint(**followed._asdict()))


def assert_same(agree, ours, theirs, index, names=None):
    for name, value in ours.items():
        if names is None or name in names:
            agree(name, value[index], crate_quantity(theirs, name), 10 * TOLERANCE if name in SOLUTIONS else TOLERANCE)


class Twin:
    """The controller of an experiment in both implementations."""

    def __init__(self, name, changes=None):
        self.table = rust.load_config(name, changes)
        config = scenario_config(self.table)
        self.robot = load_robot(config.robot)
        self.params = tick.momentum_controller(config, self.robot)

    def start(self, remembered, state):
        """Return the memory of a controller that has ticked before, but not pushed."""
        return tick.init(self.params, self.robot, state)._replace(**remembered)

    def tick(self, remembered, state, thrust, wind, followed):
        memory = self.start(remembered, state)
        return tick.tick(self.params, self.robot, memory, jnp.zeros(()), state, thrust, wind, followed)


def stack_samples(samples):
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *samples)


@pytest.fixture(scope="module")
def published():
    return Twin("test2_published")


@pytest.fixture(scope="module")
def ticks(published):
    return jax.jit(jax.vmap(published.tick))


@pytest.mark.close_to_tolerance(
    "the Hessian has the condition of G squared, 2e5 in hover, which multiplies the rounding"
)
def test_every_value_of_ticks_far_from_any_flight(published, ticks, agree):
    """With published arms and velocities; the corrected ones are compared below, where they differ."""
    samples = random_samples(published.robot, BATCH)
    memory, command, terms = jax.device_get(ticks(*stack_samples(samples)))
    ours = tick_quantities(command, terms)
    for i, sample in enumerate(samples):
        theirs = crate_tick(published.table, sample)
        assert command.degraded_modes[i] == 0
        assert theirs.degraded_modes == []
        assert not theirs.is_held
        assert_same(agree, ours, theirs, i)
        agree("velocity_error_integral", memory.velocity_error_integral[i], theirs.velocity_error_integral, 1e-9)
        assert memory.torque_is_known[i]


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("test2", {"disturbances.aero_estimate.scale": 0.7, "controller.aero_feedback.momentum_rate": "force"}),
        ("test2", {"controller.jacobian_offset": "base_rotation", "controller.aero_feedback.momentum_rate": "none"}),
        ("robustness_axisymmetric_vs_sphere_cylinder", {"controller.aero": {"model": "off"}}),
        ("test2_without_lambda_a", {"controller.lever_arm": "unrotated", "controller.axes_of": "chest"}),
        ("test2_without_torque_feedforward", {"controller.link_velocity": "shifted_twice"}),
        ("test2_without_torque_feedforward", {"controller.aero_feedback.momentum_rate": "moment"}),
        (
            "test2",
            {
                "simulator.motors": {"friction": 1.0, "damping": 0.0, "inertia": 0.0},
                "controller.torque.friction": {"torso": 1.5, "left_arm": 0.7, "right_leg": 2.0},
            },
        ),
    ],
)
def test_switches(name, changes, agree):
    """Everything that the aerodynamics of the controller enter, for every switch, one after the other."""
    twin = Twin(name, changes)
    enters = (
        *("link_v_air", "link_arm_points", "link_jacobian_points", "aero_force", "lambda_a"),
        *("momentum_rate_estimate", "k_ddot_desired", "task", "task_offset", "joint_acceleration_free"),
    )

    @jax.jit
    @jax.vmap
    def evaluate(*sample):
        _, command, terms = twin.tick(*sample)
        ours = tick_quantities(command, terms)
        return {name: ours[name] for name in enters}  # without friction the QPs drop out of what is compiled

    samples = random_samples(twin.robot, 8, seed=8)
    ours = jax.device_get(evaluate(*stack_samples(samples)))
    for i, sample in enumerate(samples):
        assert_same(agree, ours, crate_tick(twin.table, sample), i)


def test_safe_commands(published, ticks):
    """A number that overflows: where the crate holds, so do we, and with the same command."""
    good = random_samples(published.robot, BATCH, seed=9)

    def spoil(index, **changes):
        names = ("memory", "state", "thrust", "wind", "followed")
        return tuple(changes.get(name, part) for name, part in zip(names, good[index], strict=True))

    nothing = {"velocity_error_integral": np.full(23, 1e307)}  # times the gain, it overflows
    heavy = {"inertia_0": 1e307 * np.eye(3)}  # times a rate of turn, likewise
    samples = [
        spoil(0),
        spoil(1, memory=good[1][0] | heavy),
        spoil(2, memory=good[2][0] | nothing),
        spoil(3, memory=good[3][0] | nothing | heavy),
        *good[4:],
    ]
    memory, command, _ = jax.device_get(ticks(*stack_samples(samples)))
    expected = [[], ["momentum_held"], ["torque_held"], ["momentum_held", "torque_held"]]
    for i, (sample, modes) in enumerate(zip(samples, expected, strict=False)):
        theirs = crate_tick(published.table, sample)
        assert (theirs.degraded_modes, theirs.is_held) == (modes, bool(modes))
        assert command.degraded_modes[i] == sum(rust.MODES[name] for name in modes)
        assert command.momentum_qp.status[i] == theirs.momentum_answer.status_code
        assert command.torque_qp.status[i] == theirs.torque_answer.status_code
        np.testing.assert_allclose(command.thrust_rate[i], theirs.thrust_rate, rtol=0, atol=1e-6)
        np.testing.assert_allclose(command.joint_velocity[i], theirs.joint_velocity_command, rtol=0, atol=1e-8)
        np.testing.assert_allclose(command.joint_torque[i], theirs.joint_torque, rtol=0, atol=1e-6)
        integral = memory.velocity_error_integral[i]
        np.testing.assert_allclose(integral, theirs.velocity_error_integral, rtol=0, atol=1e-9)
        assert memory.torque_is_known[i] == ("torque_held" not in modes)


@pytest.fixture(scope="module")
def flown(x64):
    """Two seconds of a flight as the crate's simulator logged them, from its first tick."""
    twin = Twin("test2", {"simulator.duration": 2.0, "wind.ramp_start": 0.2, "wind.ramp_end": 1.0})
    log = rust.fly(twin.table).log
    return twin, log, (log["time"], states_of(log), log["thrust"], log["wind"])


def follow(twin, measurements, params):
    """Tick along the measurements of a flight, one after the other, with the controller's own state and set-point."""

    @jax.jit
    def scan(params, measurements):
        first = jax.tree.map(lambda leaf: leaf[0], measurements[1])

        def one(memory, measurement):
            memory, command, terms = tick.tick(params, twin.robot, memory, *measurement)
            return memory, (command, terms.setpoint.com_position)

        return jax.lax.scan(one, tick.init(params, twin.robot, first), measurements)[1]

    return jax.device_get(scan(params, measurements))


@pytest.mark.close_to_tolerance("a budget of single precision along a flight, not rounding of one operation")
def test_float32_commands_along_a_flight(flown, measured):
    """An error budget rather than parity: the QP's condition number leaves single precision three digits."""
    twin, log, measurements = flown
    single = copy.copy(twin)
    with jax.enable_x64(False):
        single.robot, params, rows = jax.tree.map(np.float32, (twin.robot, twin.params, measurements))
        command, _ = follow(single, rows, params)
    assert command.thrust_rate.dtype == np.float32
    assert not np.any(command.degraded_modes)
    measured("float32: thrust_rate [N/s]", np.max(np.abs(command.thrust_rate - log["thrust_rate"])), 0.5)
    velocity_error = np.max(np.abs(command.joint_velocity - log["joint_velocity_command"]))
    measured("float32: joint_velocity_command [rad/s]", velocity_error, 0.02)
    measured("float32: joint_torque [N m]", np.max(np.abs(command.joint_torque - log["joint_torque"])), 0.1)


def test_the_status_codes_are_the_crates():
    """Those of `QpStatus` as its source numbers them; the modes of a tick are provoked above, one by one."""
    sources = (path.read_text(encoding="utf-8") for path in (REPOSITORY / "rust").rglob("*.rs"))
    (body,) = (text.split("enum QpStatus {")[1].split("}")[0] for text in sources if "enum QpStatus {" in text)
    theirs = {name: int(code) for name, code in re.findall(r"^    (\w+) = (\d+),", body, re.MULTILINE)}
    ours = {name: getattr(qp, re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).upper(), None) for name in theirs}
    # A size is part of a JAX array's type, and there is no interior point to break down.
    assert {name for name, code in ours.items() if code is None} == {"SizeMismatch", "Breakdown"}
    assert {name: code for name, code in ours.items() if code is not None}.items() <= theirs.items()
