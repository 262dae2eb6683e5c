"""Faults of what no tick of a flight reaches are refused, and what nothing has reached is named."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.body import dynamics
from jax_aero.control.law import torques
from jax_aero.sim import prepare
from jax_aero.sim.scenario import Scenario
from jax_aero.verify import law, random_samples, reach, ticks, verify_robots
from jax_aero.verify.flight import verify_astray

pytestmark = pytest.mark.usefixtures("x64")


def test_what_no_tick_of_a_flight_reaches_is_refused(monkeypatch):
    """Six faults with which TEST2 agreed in all of its ticks."""
    config = rust.load_config("test2", {"simulator.duration": 2.0})
    (scenario, start), samples = prepare(config), random_samples(config, 50)
    robot, controller = scenario.plant.robot, scenario.controller

    def of_robot(**parts) -> Scenario:
        return replace(scenario, plant=replace(scenario.plant, robot=replace(robot, **parts)))

    def refused(twin: Scenario) -> list[str]:
        rows = ticks.compare_ticks(config, samples, ticks.twin_ticks(twin.controller, twin.model, samples))
        rows += verify_astray(config, twin, start)[1]
        return [row.quantity for row in rows if not row.agrees]

    assert refused(scenario) == []
    assert "momentum_qp.upper" in refused(of_robot(jets=replace(robot.jets, thrust_max=10.0 * robot.jets.thrust_max)))
    faster = replace(scenario, controller=replace(controller, torque_rate_max=10.0 * controller.torque_rate_max))
    assert "joint_torque" in refused(faster)
    assert "joint_velocity" in refused(of_robot(joint_stops=1.1 * robot.joint_stops))
    assert "outcome" in refused(replace(scenario, fall=replace(scenario.fall, rotation_error_deg=jnp.array(120.0))))
    monkeypatch.setattr(torques, "INTEGRAL_LIMIT", 1e3)
    ticks._twin_ticks.clear_cache()
    assert "velocity_error_integral" in refused(scenario)
    ticks._twin_ticks.clear_cache()


def test_a_wrong_sign_of_prismatic_joints_is_refused(monkeypatch):
    """The robot of TEST2 has none."""
    (path,), right = {rust.load_config("test2")["robot"]}, dynamics._inertial_wrenches
    assert all(row.agrees for row in verify_robots(path, 5))

    def wrong(robot, state, kin, *others):
        return right(robot, state, kin._replace(joint_linear=-kin.joint_linear), *others)

    monkeypatch.setattr(dynamics, "_inertial_wrenches", wrong)
    rows = verify_robots(path, 5)
    assert {(row.group, row.quantity) for row in rows if not row.agrees} == {
        ("slider", "bias"),
        ("slider", "acceleration"),
    }


def test_exchanged_gains_of_two_joints_are_refused():
    """Each joint's own posture gain acts, as the samples are away from their posture."""
    config = rust.load_config("test2_mpc")
    (params, model), samples = law.law_of(config), random_samples(config, 20)
    gain = np.array(params.tasks.posture_gain)
    other = int(np.argmax(gain != gain[0]))
    gain[[0, other]] = gain[[other, 0]]

    def refused(params) -> list[str]:
        rows = ticks.compare_ticks(config, samples, ticks.twin_ticks(params, model, samples))
        return [row.quantity for row in rows if not row.agrees]

    assert refused(params) == []
    assert refused(replace(params, tasks=params.tasks._replace(posture_gain=gain)))


def test_what_nothing_reaches_is_named():
    """Limits act in random ticks and astray, the mission does not before its flight."""
    config = rust.load_config("test2", {"simulator.duration": 2.0})
    (scenario, start), samples = prepare(config), random_samples(config, 20)
    sections, _ = verify_astray(config, scenario, start)
    found = reach.unreached(scenario, samples, sections)
    assert not {"controller.torque_rate_max", "controller.torque_max", "plant.robot.joint_stops"} & {*found}
    assert not {"plant.robot.jets.thrust_max", "fall.rotation_error_deg", "fall.com_error"} & {*found}
    assert {"controller.mission.down", "wind.ramp_end", "controller.setpoint.attitude_rate"} <= {*found}
