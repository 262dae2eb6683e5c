"""The simulator in JAX as a user composes it: own controller and air, precision, refusals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.aero import WeightedModel
from jax_aero.base import keys
from jax_aero.base.places import HOME, find
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.jets import JetsState
from jax_aero.body.kinematics import frame_poses, generalised_force, kinematics
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import rotate
from jax_aero.sim import plant
from jax_aero.types import Array, Setpoint, pytree, replace_values, value_names


@pytree
class HoverPd:
    stiffness: Array

    def init(self, _robot, state):
        return state

    def step(self, robot, first, measurement):
        state, thrust, jets = measurement.state, measurement.thrust, robot.jets
        climb = 9.0 * (first.base_position[2] - state.base_position[2]) - 6.0 * state.velocity[2]
        wanted = thrust * robot.mass * (robot.gravity + climb) / jnp.sum(thrust)
        kin = kinematics(robot, state)
        dyn = dynamics(robot, state, kin)
        rotations, points = frame_poses(kin, jets)
        force = generalised_force(robot, kin, jets.bodies, points, thrust[:, None] * rotate(rotations, jets.axes))
        pull = self.stiffness * (first.joint_position - state.joint_position)
        pull = pull - 2.0 * jnp.sqrt(self.stiffness) * state.velocity[6:]
        gain = jnp.linalg.inv(dyn.mass_matrix)[6:, 6:]
        torque = jnp.linalg.solve(gain, pull - forward_dynamics(dyn, force)[6:])
        return first, sim.Command(10.0 * (wanted - thrust), torque)


@pytree
class ConstantForce:
    force: Array

    def forces(self, links):
        return jnp.broadcast_to(self.force, links.v_air.shape)


@pytest.fixture(scope="module")
def own_flight():
    """A flight with a controller and air of one's own, and what is not known of it."""
    changes = {"simulator.duration": 0.4, "simulator.initial.free_fall_tick": False}
    config = rust.load_config("no_wind", changes)
    with jax.enable_x64(True):
        flight, still = (
            sim.run(*sim.prepare(config, controller=HoverPd(jnp.array(100.0)), aero=ConstantForce(jnp.array(force))))
            for force in ([0.0, -1.0, 0.0], [0.0, 0.0, 0.0])
        )
    names = ("base_position", "joint_position", "aero_force_sim", "momentum")
    return {name: flight[name] for name in names} | {
        "outcome": flight.outcome,
        "still_momentum": still["momentum"],
        "unknown": {name for name, values in flight.log.items() if np.isnan(values).all()},
        "unknown_figures": {name for name, value in flight.summary.items() if np.isnan(value)},
    }


def test_a_controller_of_ones_own(own_flight):
    """It holds posture and height, which 0.4 s of free fall would change by 0.78 m."""
    assert own_flight["outcome"] == "completed"
    assert len(own_flight["base_position"]) == 41
    assert np.max(np.abs(own_flight["joint_position"] - own_flight["joint_position"][0])) < 0.1
    assert np.max(np.abs(own_flight["base_position"][:, 2] - own_flight["base_position"][0, 2])) < 0.03


def test_what_a_controller_does_not_compute_is_nan(own_flight):
    """It has no set-point, no estimates and no QP; the flight is too short for figures of what comes after settling."""
    signals = {"base_rpy_setpoint", "com_setpoint", "rotation_error", "joint_velocity_command", "aero_force_control"}
    signals |= {"momentum_setpoint", "momentum_rate_estimate", "unmodelled_wrench", "degraded_modes", "joint_condition"}
    signals |= {"measured_torque_latency", "measured_thrust_latency", "raw_shaft_speed", "raw_height"}
    assert own_flight["unknown"] == signals | {"qp_status", "qp_kkt", "qp_iterations"}
    figures = {"max_rotation_error", "time_above_45_deg", "ticks_without_solution", "max_kkt", "max_qp_iterations"}
    figures |= {"max_aero_force_difference", "degraded_time", "rms_com_error", "rms_rotation_error"}
    figures |= {"nominal_until", "all_modes", "warning_time"}
    figures |= {"max_com_error", "max_com_error_x", "max_com_error_y", "max_com_error_z"}
    assert own_flight["unknown_figures"] == figures


def test_air_of_ones_own(own_flight, agree):
    """13 links, 1 N on each: from rest, the first step adds their impulse, to the second order in the step."""
    assert np.array_equal(own_flight["aero_force_sim"], np.broadcast_to([0.0, -1.0, 0.0], (41, 13, 3)))
    added = own_flight["momentum"][1] - own_flight["still_momentum"][1]
    agree("momentum added", added[1], -13.0 * 0.01, 0.01)


def test_models_without_fields_are_used_too():
    """A NamedTuple without fields is false."""

    class Own(NamedTuple):
        def init(self, _robot, _state):
            return ()

        def start(self, thrust):
            return JetsState(thrust, jnp.zeros_like(thrust))

        def feedback(self, state):
            return state.thrust

    scenario, _ = sim.prepare(rust.load_config("test2"), controller=Own(), aero=Own(), jets=Own(), dtype=np.float32)
    assert all(isinstance(model, Own) for model in (scenario.controller, scenario.plant.aero, scenario.plant.jets))


def test_arrays_and_paths_are_values(monkeypatch):
    """Where keys are set, and in a configuration that is put together; a path starts at the current folder."""
    monkeypatch.chdir(HOME)
    robot = Path("configs/robot/ironcub_mk1.toml")
    changes = {"wind.velocity": np.array([0.0, 1.0, 2.0]), "simulator.duration": np.float32(1.0), "robot": robot}
    expected = {"wind.velocity": [0.0, 1.0, 2.0], "simulator.duration": 1.0, "robot": str(robot)}
    table = rust.load_config("test2", changes)
    assert json.loads(json.dumps(table)) == table == rust.load_config("test2", expected)
    composed = table | {"robot": robot, "wind": table["wind"] | {"velocity": jnp.array([0.0, 1.0, 2.0])}}
    assert rust.config_digest(composed) == rust.config_digest(table)
    assert scenario_config(composed).wind == scenario_config(table).wind


@pytree
class Answers:
    """A controller and an aerodynamic model of one's own that answer the same always."""

    answer: Any

    def init(self, _robot, _state):
        return ()

    def step(self, _robot, memory, _measurement):
        return memory, self.answer

    def forces(self, _links):
        return self.answer


@pytest.fixture(scope="module")
def prepared():
    return sim.prepare(rust.load_config("test2", {"simulator.duration": 0.1}), dtype=np.float32)


HOLD = Setpoint(*[jnp.zeros(3)] * 4, jnp.eye(3), *[jnp.zeros(3)] * 3)
COMMAND = sim.Command(jnp.zeros(4), jnp.zeros(23), HOLD, jnp.zeros(23))


@pytest.mark.parametrize(
    ("name", "command", "expected"),
    [
        ("thrust_rate", COMMAND._replace(thrust_rate=jnp.zeros(1)), "(4,)"),
        ("thrust_rate", COMMAND._replace(thrust_rate=jnp.zeros(())), "(4,)"),
        ("joint_torque", COMMAND._replace(joint_torque=jnp.zeros(1)), "(23,)"),
        ("joint_velocity", COMMAND._replace(joint_velocity=jnp.zeros((23, 1))), "(23,)"),
        ("setpoint.com_position", COMMAND._replace(setpoint=HOLD._replace(com_position=jnp.zeros(()))), "(3,)"),
        ("setpoint.rotation", COMMAND._replace(setpoint=HOLD._replace(rotation=jnp.zeros(3))), "(3, 3)"),
    ],
)
def test_a_command_of_another_shape_is_refused_when_it_is_traced(prepared, name, command, expected):
    scenario, state = prepared

    def trace(command):
        return jax.eval_shape(
            sim.step, replace(scenario, controller=Answers(command)), state._replace(controller=()), jnp.array(0)
        )

    assert trace(COMMAND)
    with pytest.raises(ValueError, match=rf"`{name}` of the command has shape .*; expected {re.escape(expected)}"):
        trace(command)


@pytest.mark.parametrize("shape", [(), (3,), (1, 3), (13, 1)])
def test_forces_of_another_shape_are_refused_when_they_are_traced(prepared, shape):
    """Also with factors on them."""
    scenario, state = prepared
    model = Answers(jnp.ones(shape))
    for air in (model, WeightedModel(model, *jnp.ones((3, 13), jnp.float32))):
        blown = replace(scenario, plant=replace(scenario.plant, aero=air))
        message = rf"`forces` of Answers has shape {re.escape(str(shape))}; expected \(13, 3\)"
        with pytest.raises(ValueError, match=message):
            jax.eval_shape(sim.step, blown, state, jnp.array(0))


def test_double_precision_is_never_silently_missing():
    config = rust.load_config("test2", {"simulator.duration": 0.1})
    with pytest.raises(ValueError, match=r"float64.*jax.enable_x64"):
        sim.prepare(config)
    single = sim.prepare(config, dtype=np.float32)
    floats = [leaf.dtype for leaf in jax.tree.leaves(single) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert set(floats) == {np.dtype(np.float32)}
    with jax.enable_x64(True):
        double = sim.prepare(config)
    with pytest.raises(ValueError, match=r"prepared in float64, but its numbers are float32 here"):
        jax.eval_shape(lambda scenario, state: sim.rollout(scenario, state, 2, sim.keep_row), *double)


@pytest.mark.parametrize(("name", "changes"), [("test2", {}), ("sensor_noise", {"simulator.actuation": {}})])
def test_another_duration_compiles_nothing(name, changes, monkeypatch):
    """Below 250 ticks the same arguments, also where noise is drawn."""
    called = []

    def compiled(scenario, state, first, n_ticks):
        shapes = [(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in jax.tree.leaves((scenario, state, first))]
        called.append((jax.tree.structure((scenario, state)), shapes, n_ticks))
        raise KeyboardInterrupt

    monkeypatch.setitem(sim.run.__globals__, "fly_chunk", compiled)
    for duration in (0.1, 0.37, 2.49):
        flight = sim.prepare(rust.load_config(name, changes | {"simulator.duration": duration}), dtype=np.float32)
        with pytest.raises(KeyboardInterrupt):
            sim.run(*flight)
    assert called[0] == called[1] == called[2]


def test_a_robot_of_another_configuration_is_refused():
    with pytest.raises(ValueError, match=r"`robot` is that of .*sparrow\.toml; expected that .*mk1"):
        sim.prepare(rust.load_config("test2"), load_robot(find("robot", "sparrow")), dtype=np.float32)


def test_what_others_were_computed_from_does_not_change():
    """They would stay as they are: filters, delays and noise."""
    config = rust.load_config("test2", {"simulator.duration": 0.1, "simulator.actuation": {"drop": 0.1}})
    scenario, _ = sim.prepare(config, dtype=np.float32)
    names = ("plant.time_step", "controller.time_step", "controller.setpoint.time_step")
    for values in [*({name: 0.02} for name in names), {"n_ticks": 20}]:
        with pytest.raises(ValueError, match=rf"`{next(iter(values))}` is what others .*; expected `prepare`"):
            replace_values(scenario, values)
    names = value_names(scenario)
    assert {"wind.velocity", "controller.momentum.kp_linear"} <= {*names}
    assert not {"n_ticks", "plant.time_step", "plant.has_stops"} & {*names}
    assert not replace_values(scenario, {"wind.velocity": jnp.zeros(3)}).wind.velocity.any()
    exact = replace(scenario, actuation=None)
    assert replace_values(exact, {"n_ticks": 20}).n_ticks == 20


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("n_ticks", 10.5, r"`n_ticks` is 10\.5; expected values of type int"),
        ("measuring", None, r"`measuring` is \w+; expected the name of a number or an array"),
        ("wind", 1.0, r"`wind` is \w+; expected the name of a number or an array"),
        ("wind.velocity", "fast", r"`wind\.velocity` is 'fast'; expected a number or an array"),
        ("wind.velocity", None, r"`wind\.velocity` is None; expected a number or an array"),
        ("wind.velocty", 1.0, "`velocty` in `wind.velocty` is unknown; did you mean velocity"),
        ("plant.has_stops", False, "`plant.has_stops` is fixed at compilation; expected `prepare` with another"),
        ("plant.substeps", 2, r"`plant\.substeps` is fixed at compilation"),
        ("controller.switches.latency", 0.01, r"`controller\.switches\.latency` is fixed at compilation"),
        ("precision", "float64", r"`precision` is fixed at compilation"),
        ("wind.velocity", [0.0, 1.0], r"`wind\.velocity` has shape \(2,\); expected \(3,\)"),
    ],
)
def test_changed_refuses_what_is_no_leaf(name, value, words):
    scenario, _ = sim.prepare(rust.load_config("test2", {"simulator.duration": 0.1}), dtype=np.float32)
    with pytest.raises(ValueError, match=words):
        replace_values(scenario, {name: value})


@pytest.mark.parametrize(("ticks", "recompute"), [(0, True), (2, True), (2, False)])
def test_a_rollout_has_a_row_for_every_tick(ticks, recompute):
    start = sim.prepare(rust.load_config("test2", {"simulator.duration": 0.1}), dtype=np.float32)
    after, rows = jax.eval_shape(lambda *flight: sim.rollout(*flight, ticks, sim.keep_row, recompute=recompute), *start)
    assert jax.tree.structure(after) == jax.tree.structure(start[1])
    assert {leaf.shape[0] for leaf in jax.tree.leaves(rows)} == {ticks}


@pytest.mark.parametrize("ticks", [-1, 1.5])
def test_a_rollout_refuses_a_number_that_counts_nothing(ticks):
    with pytest.raises(ValueError, match=f"`n_ticks` is {ticks}; expected an integer"):
        sim.rollout(None, None, ticks, sim.keep_row)


def test_a_tick_has_products_in_full_precision_alone():
    """Of controller and robot: with a device's default a GPU rounds factors to ten bits."""
    flight = sim.prepare(rust.load_config("test2", {"simulator.duration": 0.1}), dtype=np.float32)
    program = str(jax.make_jaxpr(lambda *flight: sim.step(*flight, jnp.array(0)))(*flight))
    assert set(re.findall(r"precision=\S+", program)) == {"precision=(Precision.HIGHEST,"}


SPOILT = {"simulator.integrator": ("rk4", "semi_implicit_euler"), "simulator.duration": (1e9, "ten million ticks")}


@pytest.mark.parametrize("key", SPOILT)
def test_what_cannot_fly_is_refused_by_key_and_expectation(key):
    value, expected = SPOILT[key]
    table = rust.load_config("test2")
    keys.set_key(table, key, value)
    for fly in (sim.fly, lambda table: sim.fly_batch([table])):
        with pytest.raises(ValueError, match=rf"{key}.*{expected}|{expected}.*{key}"):
            fly(table)


def test_an_empty_mission_hovers():
    table = rust.load_config("test2") | {"mission": {}}
    rust.check_config(table)
    assert scenario_config(table).mission.up == ()


def test_the_crate_flies_one_kind_of_dynamics():
    rust.load_config("test2", {"simulator.dynamics": "tree"})
    with pytest.raises(ValueError, match=r"simulator.dynamics.*mjx.*tree"):
        rust.load_config("test2", {"simulator.dynamics": "mjx"})


def test_compilers_without_the_option_are_not_asked_for_it():
    """XLA refuses options that it does not have."""
    assert plant.options_of((0, 12, 0, 1)) == {}
    assert jax.jit(lambda x: x + 1.0, compiler_options=sim.COMPILER_OPTIONS)(1.0) == 2.0
