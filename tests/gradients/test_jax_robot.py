"""The gradient of a second of the recommended robot against difference quotients of the crate.

Engines, drives, ten sub-steps, late commands, sensors, estimator and plans are all in it. Encoders have no steps here:
with them a flight is piecewise constant in what they measure (`jax_aero.sim.sensors`).
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from tests.measurements import measured

pytestmark = pytest.mark.usefixtures("x64")

TICKS = 100
"""A rollout of at most so many is not cut into parts, of which each would be compiled."""
STEP = 1e-7
"""Of the quotients, relative: between the rounding of a flight and the next motor that sticks or slips."""
KEYS = {"drag": "disturbances.aero.drag", "mass": "disturbances.model_error.mass_scale", "gain": "controller.torque.kp"}
AT = {"drag": 1.1, "mass": 1.01, "gain": 225.0}
# With compensated friction, which turns with the sign of a commanded velocity, the quotient by drag is 4e-4 off.
CHANGES = {
    "simulator.duration": 0.99,
    "simulator.sensors.joints.resolution": 0.0,
    "simulator.aero.precision": "f64",
    "controller.torque.friction": dict.fromkeys(("torso", "left_arm", "right_arm", "left_leg", "right_leg"), 0.0),
    "wind.ramp_start": -1.0,
    "wind.ramp_end": 0.5,
}


def configured(at):
    return rust.load_config("robot", CHANGES | {KEYS[name]: float(value) for name, value in at.items()})


def cost(xp, log):
    """Errors of position, velocities of the base and torques, summed over a flight."""
    error = log["com_position"] - log["com_setpoint"]
    return xp.sum(error**2) + xp.sum(log["base_velocity"] ** 2) + 1e-5 * xp.sum(log["joint_torque"] ** 2)


def fly(at):
    flight = rust.fly(configured(at))
    assert len(flight["time"]) == TICKS
    assert not flight["degraded_modes"].any()
    return cost(np, flight)


@pytest.mark.slow
def test_gradient_of_a_second_of_a_robot():
    scenario, start = sim.prepare(configured(AT))
    plant, controller, model = scenario.plant, scenario.controller, scenario.controller_model

    def cost_of(at):
        masses, inertias = at["mass"] * plant.robot.masses, at["mass"] * plant.robot.inertias
        changed = replace(
            scenario,
            plant=replace(plant, aero=replace(plant.aero, drag=at["drag"] * jnp.ones_like(plant.aero.drag))),
            controller=replace(controller, torque=replace(controller.torque, kp=at["gain"])),
            controller_model=replace(model, masses=masses, inertias=inertias),
        )
        names = ("com_position", "com_setpoint", "base_velocity", "joint_torque")
        begun = sim.begin(changed, start.plant)
        _, log = sim.rollout(changed, begun, TICKS, lambda row: {name: row[name] for name in names})
        return cost(jnp, log)

    at = {name: jnp.asarray(value) for name, value in AT.items()}
    value, slopes = jax.jit(jax.value_and_grad(cost_of))(at)
    measured("cost", abs(float(value) / fly(AT) - 1.0), 1e-7)
    for name, number in AT.items():
        ahead, behind = (fly(AT | {name: number * (1.0 + sign * STEP)}) for sign in (1.0, -1.0))
        quotient = (ahead - behind) / (2.0 * STEP * number)
        because = "the rounding of a flight, over the step: 4e-5 is what one-sided quotients differ by"
        measured(f"slope by {name}", abs(float(slopes[name]) / quotient - 1.0), 1e-4, because)
