"""The closed loop in JAX against the Rust crate: whole flights, and single steps of the plant."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import rotation_from_wxyz
from jax_aero.control.tick import MomentumController
from jax_aero.sim.outcome import lost_reason
from jax_aero.sim.plant import Acting, advance, observe, start_plant
from jax_aero.sim.wind import wind_model, wind_velocity
from jax_aero.types import State, pytree

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_a_flight_of_50_s(fly_both):
    """Every signal at every tick to 1e-6, and the same figures of merit."""
    _, ours = fly_both(rust.load_config("test2"))
    assert len(ours["time"]) == 5001


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [
        ({"simulator.fall.com_error": 0.02}, "fell"),
        ({"simulator.fall.rotation_error_deg": 0.5}, "fell"),
        ({"simulator.duration": 3.5, "disturbances.model_error.mass_scale": 0.9}, "off_course"),
    ],
)
def test_a_flight_under_a_strict_judge(changes, outcome, fly_both):
    """Lost at the same tick for the same reason, where the log ends, or off course."""
    expected, _ = fly_both(rust.load_config("test2", changes))
    assert expected.outcome == outcome


@pytest.mark.parametrize("name", ["min_time", "min_fuel"])
def test_a_flight_along_a_recorded_reference(name, fly_both):
    """Minimum fuel has a second in which an error grows tenfold every 0.1 s, in either implementation."""
    fly_both(rust.load_config(name))


VARIANTS = {
    "engine_out": {"simulator.duration": 24.0, "disturbances.jets.thrust_limit_scale": 0.85},
    "second_order_jets": {},
    "test2": {
        "simulator.substeps": 3,
        "simulator.integrator": "explicit_euler",
        "simulator.kinematics": "frozen",
        "simulator.lever_arm": "unrotated",
    },
}


@pytest.mark.parametrize("experiment", VARIANTS)
@pytest.mark.usefixtures("x64")
def test_every_tick_of_the_world(experiment, agree):
    """From each logged state, one tick under the logged commands leads to the next logged state."""
    changes = {"simulator.duration": 8.0} | VARIANTS[experiment]
    table = rust.load_config(experiment, changes)
    rust.check_config(table)
    config, log = scenario_config(table), rust.fly(table).log
    robot, wind_now = load_robot(table["robot"]), wind_model(config.wind)
    plant, start = jax.jit(lambda: start_plant(config, robot))()
    velocity = np.concatenate([log["base_velocity"], log["joint_velocity"]], axis=1)
    agree("first state", start.robot.velocity, velocity[0], 1e-10)

    def tick_world(jets, logged):
        time, position, wxyz, joints, velocity, torque, thrust_rate = logged
        robot = State(position, rotation_from_wxyz(wxyz), joints, velocity)
        state = start._replace(robot=robot, jets=jets)
        wind = wind_velocity(wind_now, time)
        seen = observe(plant, state, wind)
        after = advance(plant, state, seen, Acting(thrust_rate, jnp.tile(torque, (plant.substeps, 1))), wind)
        return after.jets, (seen.link_forces.forces, after.robot, after.jets.thrust, wind)

    names = ("time", "base_position", "base_quaternion", "joint_position")
    logged = (*(log[name] for name in names), velocity, log["joint_torque"], log["thrust_rate"])
    _, (forces, after, thrust, wind) = jax.jit(
        lambda: jax.lax.scan(tick_world, start.jets, jax.tree.map(jnp.asarray, logged))
    )()
    agree(f"{experiment}: wind", wind, log["wind"], 1e-12)
    agree(f"{experiment}: forces", forces, log["aero_force_sim"], 1e-10)
    agree(f"{experiment}: thrust", thrust[:-1], log["thrust"][1:], 1e-10)
    agree(f"{experiment}: next position", after.base_position[:-1], log["base_position"][1:], 1e-10)
    agree(f"{experiment}: next joints", after.joint_position[:-1], log["joint_position"][1:], 1e-10)
    agree(f"{experiment}: next velocity", after.velocity[:-1], velocity[1:], 1e-10)


@pytest.mark.parametrize("integrator", ["semi_implicit_euler", "explicit_euler"])
@pytest.mark.usefixtures("x64")
def test_joints_meet_their_stops(integrator, agree):
    """Elbow, knee and torso pressed against their stops for 0.3 s, without thrust: both engines, step by step."""
    changes = {"simulator.integrator": integrator, "simulator.substeps": 2, "simulator.aero": {"model": "off"}}
    table = rust.load_config("test2") | {"disturbances": {}}
    for key, value in changes.items():
        table["simulator"][key.removeprefix("simulator.")] = value
    table["simulator"]["initial"] |= {"thrust": [0.0] * 4, "free_fall_tick": False}
    crate, config = rust.Flight(table), scenario_config(table)
    plant, state = start_plant(config, load_robot(table["robot"]))
    names = rust.Robot(table["robot"]).joint_names
    torque, rest = np.zeros(23), np.zeros(3)
    pressed = [names.index(name) for name in ("l_elbow", "r_knee", "torso_roll")]
    torque[pressed] = -20.0, 30.0, 40.0
    acting = Acting(np.zeros(4), np.tile(torque, (plant.substeps, 1)))
    step = jax.jit(lambda state: advance(plant, state, observe(plant, state, rest), acting, rest))
    for _ in range(30):
        state, _ = step(state), crate.step(command=rust.Command(np.zeros(4), torque))
    measured = crate.truth
    from_stop = np.abs(np.asarray(state.robot.joint_position) - np.asarray(plant.robot.joint_stops).T).min(axis=0)
    assert np.all(from_stop[pressed] < 1e-3)
    # 60 steps at stiff stops, each solved to 1e-16 times the condition of M, 1e5.
    agree("joints", state.robot.joint_position, measured.state.joint_position, 1e-9)
    agree("velocities", state.robot.velocity, measured.state.velocity, 1e-8)


SPOILT = {
    "speed": {"simulator.initial.base_velocity": [0.0, 301.0, 0.0, 0.0, 0.0, 0.0]},
    "angular velocity": {"simulator.initial.base_velocity": [0.0, 0.0, 0.0, 0.0, -101.0, 0.0]},
    "joint more": {"simulator.joint_stops": False},
}


@pytest.mark.parametrize("criterion", SPOILT)
def test_numbers_that_physics_excludes_diverge(criterion):
    """The same tick, words and figures in both engines; the row is in the log and in no figure."""
    changes = SPOILT[criterion] | {"simulator.duration": 0.5, "simulator.initial.free_fall_tick": False}
    if criterion == "joint more":
        elbow_out = list(rust.load_config("test2")["simulator"]["initial"]["joint_position"])
        elbow_out[6] -= 8.0
        changes["simulator.initial.joint_position"] = elbow_out
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "simulator.initial.joint_position of `l_elbow`")
        config = rust.load_config("test2", changes)
    expected, ours = rust.fly(config), sim.fly(config)  # nothing of such a flight can be compared by value
    assert ours.outcome == expected.outcome == "diverged"
    assert (ours.lost_time, ours.lost_reason) == (expected.lost_time, expected.lost_reason)
    assert criterion in ours.lost_reason
    assert ours["time"].shape == expected["time"].shape
    for name in set(expected.summary) - {"max_kkt", "max_qp_iterations"}:
        assert ours.summary[name] == pytest.approx(expected.summary[name], rel=1e-6, abs=1e-9, nan_ok=True), name


@pytest.mark.usefixtures("x64")
def test_a_joint_that_is_driven_too_fast_diverges():
    """Thrusts of ten times the greatest, which no command reaches before the robot falls: `verify.everything`."""
    config = rust.load_config("test2", {"simulator.duration": 0.5, "simulator.joint_stops": False})
    crate, (scenario, state) = rust.Flight(config), sim.prepare(config)
    while crate.step(command=rust.Command(np.zeros(4), np.where(np.arange(23) == 6, 70.0, 0.0))):
        pass
    robot = state.plant.robot
    too_fast = state.plant._replace(robot=robot._replace(velocity=robot.velocity.at[10].set(-101.0)))
    after, _ = jax.jit(sim.step)(scenario, state._replace(plant=too_fast), 0)
    assert lost_reason(int(after.loss), 0.0) == crate.result().lost_reason
    assert "joint velocity" in crate.result().lost_reason


PERTURBED = {
    "simulator.duration": 12.0,
    "wind.ramp_start": 0.5,
    "wind.ramp_end": 2.0,
    "disturbances.aero.drag": 1.3,
    "disturbances.aero.normal": 0.6,
    "disturbances.aero.links": {"chest": 1.5, "l_upper_leg": 0.5},
    "disturbances.model_error.mass_scale": 1.02,
    "disturbances.model_error.com_offset": [0.004, -0.002, 0.01],
}


def test_a_flight_with_everything_wrong(fly_both):
    """Published lever arms, forces that are not those of the model, masses that are not those of the controller."""
    fly_both(rust.load_config("test2_published", PERTURBED))


TURBULENT = {
    "profile": "turbulent",
    "velocity": [0.0, -3.0, 0.0],
    "ramp_start": 0.1,
    "ramp_end": 0.3,
    "std": [1.0, 2.0, 0.5],
    "time_scale": 0.6,
    "seed": 4,
}
WINDS = {
    "turbulent": TURBULENT,
    "calm that is turbulent": TURBULENT | {"velocity": [0.0, 0.0, 0.0], "seed": 2**60 + 7},
    "constant": {"profile": "constant", "velocity": [1.0, -2.0, 0.5]},
    "gust": {"profile": "gust", "velocity": [0.0, -4.0, 0.0], "gust": [2.0, 0.0, -1.0], "start": 0.1, "duration": 0.2},
    "samples": {
        "profile": "samples",
        "samples": [[0.05, 1.0, 2.0, 3.0], [0.1, -1.0, 0.5, 0.0], [0.25, 4.0, -3.0, 1.0]],
    },
    "step": {"profile": "ramp", "velocity": [0.0, -3.0, 0.0], "ramp_start": 0.2, "ramp_end": 0.2},
}


@pytest.mark.close_to_tolerance("turbulence sums random numbers of two libraries: a logarithm, a root, a sine each")
@pytest.mark.parametrize("profile", [*WINDS, "file"])
@pytest.mark.usefixtures("x64")
def test_winds(profile, tmp_path):
    samples = tmp_path / "wind.csv"
    samples.write_text("time,x,y,z\n0.05,1,2,3\n0.1,-1,0.5,0\n0.25,4,-3,1\n")
    wind = WINDS.get(profile, {"profile": "file", "path": str(samples)})
    table = rust.load_config("test2", {"simulator.duration": 0.4}) | {"wind": wind}
    log, model = rust.fly(table).log, wind_model(scenario_config(table).wind)
    ours = jax.vmap(lambda time: wind_velocity(model, time))(jnp.asarray(log["time"]))
    np.testing.assert_allclose(ours, log["wind"], rtol=0, atol=1e-12)


@pytree
class Damper:
    """Dampens joints: a controller so small that only the plant takes time to compile."""

    def init(self, _robot, _state):
        return ()

    def step(self, _robot, state, measurement):
        return state, sim.Command(jnp.zeros_like(measurement.thrust), -0.05 * measurement.state.velocity[6:])


@pytest.mark.usefixtures("x64")
def test_both_kinds_of_dynamics_fly_the_same():
    """`simulator.dynamics`: one step to the rounding of M⁻¹ h (condition 1e5), and 0.2 s with what it grows to."""
    heights = {}
    for dynamics in ("tree", "mjx"):
        changes = {"backend": "jax", "simulator.dynamics": dynamics, "wind.ramp_start": -9.0}
        table = rust.load_config("test2", changes)
        scenario, start = sim.prepare(table, controller=Damper())
        assert scenario.plant.backend == dynamics
        rows = jax.jit(lambda scenario, start: sim.rollout(scenario, start, 20, sim.keep_row)[1])(scenario, start)
        np.testing.assert_allclose(rows["time"], np.arange(20) * float(scenario.plant.time_step), rtol=1e-15)
        heights[dynamics] = np.concatenate(
            [rows["base_position"], rows["base_velocity"], rows["joint_position"]], axis=1
        )
    apart = np.abs(heights["tree"] - heights["mjx"]).max(axis=1)
    assert apart[1] < 1e-11
    assert apart.max() < 1e-8


@pytree
class Wrapped:
    """A controller of one's own around the configured one."""

    inner: MomentumController

    def init(self, robot, state):
        return self.inner.init(robot, state)

    def step(self, robot, state, measurement):
        return self.inner.step(robot, state, measurement)


@pytest.mark.parametrize(
    ("changes", "shares"), [({}, True), ({"controller.estimator": {}}, False), ({"simulator.sensors": {}}, False)]
)
@pytest.mark.usefixtures("x64")
def test_the_world_is_not_where_the_controller_estimates_it(monkeypatch, changes, shares):
    """It takes over what a controller computed for its own state alone."""
    config = scenario_config(rust.load_config("no_wind", changes))
    scenario, start = sim.prepare(config)
    scenario, taken = dataclasses.replace(scenario, controller=Wrapped(scenario.controller)), []

    def observe_and_record(plant, state, wind, known=None):
        taken.append(known is not None)
        return observe(plant, state, wind, known)

    monkeypatch.setattr("jax_aero.sim.plant.observe", observe_and_record)
    jax.eval_shape(lambda *flight: sim.step(*flight), scenario, start, jnp.array(0))
    assert taken == [shares]


def test_a_controller_whose_model_has_rotors(fly_both):
    """With an estimator, which contains them too."""
    drives = {"simulator.motors": {"friction": 0.0, "damping": 0.0, "inertia": 0.002}, "simulator.duration": 0.3}
    expected, _ = fly_both(rust.load_config("test2_sensors", {**drives, "controller.torque.rotor_inertia": 0.002}))
    without = rust.fly(rust.load_config("test2_sensors", drives))
    assert np.abs(expected["joint_torque"] - without["joint_torque"]).max() > 1e-3


RISING = {
    "simulator.initial.thrust": [11.5, 12.0, 90.0, 90.0],
    "simulator.initial.base_velocity": [0, 0, 3, 0, 0, 0],
    "controller.fault_detection.tracking_error": False,  # such a start strays, which JAX does not report
}


@pytest.mark.parametrize("name", ["mk3_test2", pytest.param("mk3_test2_mpc", marks=pytest.mark.slow)])
def test_another_robot_whose_thrusts_are_at_their_least(name, fly_both):
    """IRonCub-Mk3 rises too fast; 4 m/s would amplify a rounding of the start to 1e-4 N m in 0.4 s in either engine."""
    changes = {"simulator.duration": 0.2} | RISING
    expected, _ = fly_both(rust.load_config(name, changes))
    assert expected["thrust"].min() == 11.0
