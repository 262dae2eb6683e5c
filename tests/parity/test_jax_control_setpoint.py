"""JAX set-points against the Rust crate's, tick by tick, for every mission."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.control.law import mission, recorded, setpoint
from jax_aero.sim.plant import n_ticks
from tests.measurements import measured

pytestmark = pytest.mark.usefixtures("x64")

START = (np.array([-0.00365, 0.00041, 0.751881]), np.diag([-1.0, -1.0, 1.0]))
FORWARD = np.array([-1.0, 0.0, 0.0])
# Positions of 80 m are rounded to 1e-14; three differentiations at T = 1.5 s and 5 ms make 1e-12 of it.
TOLERANCE = {"com_jerk": 1e-11}


@functools.partial(jax.jit, static_argnums=3)
def follow(params, mission, start, ticks):
    """Set-points of a whole flight, one row for every tick."""

    def tick(state, index):
        state, made = setpoint.update(params, mission, state, index * params.time_step)
        return state, made._asdict() | {"raw_position": state.raw.position, "raw_rpy": state.raw.rpy}

    return jax.lax.scan(tick, setpoint.start(params, *start), jnp.arange(ticks))[1]


@pytest.mark.close_to_tolerance("the tolerance is the bound of TOLERANCE's comment, without a factor to spare")
@pytest.mark.parametrize("name", ["test2", "closed_circuit", "closed_circuit_no_turbo"])
def test_setpoints(name, agree):
    table = rust.load_config(name)
    config = scenario_config(table)
    time_step = jnp.array(config.controller.time_step)
    params = setpoint.setpoint_params(config.controller.setpoint, FORWARD, time_step)
    ours = jax.device_get(follow(params, mission.commands(config.mission), START, n_ticks(config) + 1))
    theirs = rust.setpoint_trajectory(table, *START)
    assert ours.keys() == theirs.keys()
    for signal, expected in theirs.items():
        agree(signal, ours[signal], expected, TOLERANCE.get(signal, 1e-12))


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2, np.pi / 2 - 1e-5])
def test_setpoints_of_a_start_without_a_heading(pitch, agree):
    """A base that is pitched to the vertical, where rounding would decide on roll and yaw, keeps its attitude."""
    rotation = Rotation.from_euler("ZYX", [0.7, pitch, 0.4]).as_matrix()
    table = rust.load_config("test2", {"simulator.duration": 2.0})
    table["controller"]["setpoint"]["nose_down_limits_deg"] = [-90.0, 90.0]
    config = scenario_config(table)
    params = setpoint.setpoint_params(config.controller.setpoint, FORWARD, jnp.array(config.controller.time_step))
    start = (START[0], rotation)
    ours = jax.device_get(follow(params, mission.commands(config.mission), start, n_ticks(config) + 1))
    agree("attitude that is kept", ours["rotation"][-1], rotation, 1e-10)
    theirs = rust.setpoint_trajectory(table, *start)
    for signal in ("raw_rpy", "rotation"):
        agree(f"vertical: {signal}", ours[signal], theirs[signal], 1e-10)


def test_a_motion_that_is_followed_goes_on_without_jerk(agree):
    """The raw set-point is the input that the filter of the position follows with these outputs."""
    config = scenario_config(rust.load_config("test2")).controller.setpoint
    params = setpoint.setpoint_params(config, FORWARD, jnp.array(1e-3))
    rng = np.random.default_rng(6)
    com = np.concatenate([rng.normal(size=(3, 3)), np.zeros((1, 3))])
    motion = recorded.RecordedMotion(jnp.asarray(com), jnp.asarray(START[1]), jnp.zeros(3))
    state = setpoint.follow(params, setpoint.start(params, *START), motion)
    a, b, c = 150.765868956161, 84.9812819469538, 15.9669610709384
    smoothing = 1.5
    lag = smoothing * b / a
    expected = com[0] + lag * com[1] + smoothing**2 * c / a * com[2]
    agree("raw position", state.raw.position, expected, 1e-14)
    agree("raw velocity", state.raw.velocity, com[1] + lag * com[2], 1e-14)
    position, velocity, _, _ = com + np.vstack([1e-3 * com[1:], np.zeros(3)])
    _, after = setpoint.move_on(params, state)
    np.testing.assert_allclose(after.com_position, position, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(after.com_velocity, velocity, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(after.com_acceleration, com[2], rtol=0.0, atol=0.02)


HEADER = ["time", "x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "ax", "ay", "az", "jx", "jy", "jz"]


@pytest.mark.parametrize("columns", [7, 10, 13, 16])
def test_recorded_setpoints(columns, agree, tmp_path):
    """Uneven samples with all or some derivatives: before, on, between and after them."""
    rng = np.random.default_rng(columns)
    times = np.round(np.concatenate([[0.05], np.cumsum(rng.uniform(0.01, 0.3, 9)) + 0.05]), 2)
    rows = np.column_stack([times, 0.3 * rng.normal(size=(10, columns - 1))])
    path = tmp_path / "reference.csv"
    lines = ["# made up", ",".join(HEADER[:columns]), *(",".join(map(repr, map(float, row))) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    table = rust.load_config("min_time", {"simulator.duration": 2.0})
    table["mission"]["file"] = str(path)
    rust.check_config(table)
    config = scenario_config(table)

    time_step = jnp.array(config.controller.time_step)
    params = setpoint.setpoint_params(config.controller.setpoint, FORWARD, time_step)
    recording = recorded.recording(recorded.read_reference(config.mission.file))
    ours = jax.device_get(follow(params, recording, START, n_ticks(config) + 1))
    for signal, expected in rust.setpoint_trajectory(table, *START).items():
        agree(f"recorded: {signal}", ours[signal], expected, TOLERANCE.get(signal, 1e-12))


@pytest.mark.close_to_tolerance("80 m in float32 after 5001 sums: 80 m eps sqrt(5001) = 0.3 mm and more, as claimed")
def test_float32_setpoints_stay_within_a_millimetre_and_a_hundredth_of_a_degree():
    table = rust.load_config("test2")
    with jax.enable_x64(False):
        config = scenario_config(table)
        time_step = jnp.float32(config.controller.time_step)
        params = setpoint.setpoint_params(config.controller.setpoint, jnp.float32(FORWARD), time_step)
        start = tuple(map(jnp.float32, START))
        found = jax.device_get(follow(params, mission.commands(config.mission), start, 5001))
    theirs = rust.setpoint_trajectory(table, *START)
    assert found["com_position"].dtype == np.float32
    measured(
        "com_position against the resampled one", np.max(np.abs(found["com_position"] - theirs["com_position"])), 1e-3
    )
    measured("rotation against the resampled one", np.max(np.abs(found["rotation"] - theirs["rotation"])), 2e-4)


def test_a_set_point_later_is_the_integral_of_its_derivatives(x64):
    """Each derivative is that of what it integrates, at 0.3 s, and that of the rotation at 0."""
    vectors = np.random.default_rng(2).normal(size=(7, 3))
    given = setpoint.Setpoint(*vectors[:4], np.eye(3), *vectors[4:])
    at, rate = jax.jvp(lambda time: setpoint.after(given, time), (0.3,), (1.0,))
    names = setpoint.Setpoint._fields
    for low, high in (*itertools.pairwise(names[:4]), *itertools.pairwise(names[5:])):
        np.testing.assert_allclose(getattr(rate, low), getattr(at, high), rtol=1e-12, err_msg=low)
    turning = jax.jvp(lambda time: setpoint.after(given, time).rotation, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(turning[[2, 0, 1], [1, 2, 0]], given.angular_velocity, rtol=1e-12)
