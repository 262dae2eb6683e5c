"""Differences between the controller's robot and the one that flies."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp

from jax_aero.body.robot import RobotModel
from jax_aero.config import ModelError, ScenarioConfig
from jax_aero.types import leaf


def controller_model(config: ScenarioConfig, robot: RobotModel) -> RobotModel | None:
    """Return the controller's model of the robot; `None` if it is the robot that flies."""
    error, faults = config.disturbances.model_error, config.disturbances.jets
    model = robot
    if faults.limit_is_known and faults.thrust_limit_scale is not None:
        limits = jnp.asarray(faults.thrust_limit_scale * robot.jets.thrust_max)
        model = replace(robot, jets=replace(robot.jets, thrust_max=limits))
    if error != ModelError():
        masses, inertias = error.mass_scale * robot.masses, error.mass_scale * robot.inertias
        coms = jnp.asarray(robot.coms).at[0].add(leaf(error.com_offset))
        model = replace(model, masses=masses, coms=coms, inertias=inertias)
    if config.controller.torque.rotor_inertia > 0.0:
        model = replace(model, rotor_inertia=leaf(config.controller.torque.rotor_inertia * robot.joint_turns))
    return None if model is robot else model
