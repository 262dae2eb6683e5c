"""Differences between the controller's robot and the one that flies."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import exp_so3
from jax_aero.config import ModelError, ScenarioConfig
from jax_aero.types import leaf


def controller_model(config: ScenarioConfig, robot: RobotModel) -> RobotModel | None:
    """Return the controller's model of the robot; `None` if it is the robot that flies."""
    error, faults = config.disturbances.model_error, config.disturbances.jets
    model = robot
    if faults.limit_is_known and faults.thrust_limit_scale is not None:
        limits = jnp.asarray(faults.thrust_limit_scale * robot.jets.thrust_max)
        model = replace(robot, jets=replace(robot.jets, thrust_max=limits))
    if not error.of_plant:
        model = _with(error, model)
    if config.controller.torque.rotor_inertia > 0.0:
        model = replace(model, rotor_inertia=leaf(config.controller.torque.rotor_inertia * robot.joint_turns))
    # A simulated robot with errors is another one than that of the file, which the controller then has.
    return None if model is robot and simulated_robot(config, robot) is robot else model


def simulated_robot(config: ScenarioConfig, robot: RobotModel) -> RobotModel:
    """Return the simulated robot: the one of the file, or with the errors that the plant has."""
    error = config.disturbances.model_error
    return _with(error, robot) if error.of_plant else robot


def _with(error: ModelError, robot: RobotModel) -> RobotModel:
    """Return a robot with these errors, itself without any."""
    if error == ModelError(of_plant=error.of_plant):
        return robot
    if error.thrust_axes:
        axes = jax.vmap(lambda turn, axis: exp_so3(turn) @ axis)(leaf(error.thrust_axes), jnp.asarray(robot.jets.axes))
        robot = replace(robot, jets=replace(robot.jets, axes=axes))
    return replace(
        robot,
        masses=error.mass_scale * robot.masses,
        inertias=error.mass_scale * error.inertia_scale * robot.inertias,
        coms=jnp.asarray(robot.coms).at[0].add(leaf(error.com_offset)),
    )
