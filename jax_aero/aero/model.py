"""Aerodynamic models, and the functions that dispatch on them."""

from __future__ import annotations

from typing import Literal, TypeAlias

import jax.numpy as jnp

from jax_aero import config
from jax_aero.aero.axisymmetric import Axisymmetric, axisymmetric_forces
from jax_aero.aero.network import Network, network_forces, with_precision
from jax_aero.aero.network_card import load_network
from jax_aero.aero.sphere_cylinder import SphereCylinder, sphere_cylinder_forces, sphere_cylinder_model
from jax_aero.config import Off
from jax_aero.robot import RobotModel
from jax_aero.types import Array, Kinematics, Static, pytree


@pytree
class NetworkModel:
    """A neural network of wind and posture, which looks at the whole robot at once."""

    network: Network
    air_density: Array
    """() [kg/m³]."""
    precision: Static[Literal["f32", "f64"]]
    """Of the weighted sums: single, or that of the flight."""


AeroModel: TypeAlias = Off | Axisymmetric | SphereCylinder | NetworkModel
"""An aerodynamic model of a robot's links; its numbers are leaves."""


def aero_model(settings: config.AeroConfig, robot: RobotModel) -> AeroModel:
    """Build the model of a configuration. Do it once, outside loops: tables are computed here.

    Raises
    ------
    ValueError
        If the robot lacks the coefficient set, or a network's card or weights are not what they should be.
    """
    if isinstance(settings, config.AxisymmetricConfig):
        sets = robot.aero_links.coefficients
        if settings.coefficients not in sets:
            raise ValueError(f"coefficients is `{settings.coefficients}`; {robot.name} has {', '.join(sorted(sets))}")
        return Axisymmetric(k_a=0.5 * settings.air_density, areas=sets[settings.coefficients])
    if isinstance(settings, config.SphereCylinderConfig):
        return sphere_cylinder_model(settings, robot.aero_links)
    if isinstance(settings, config.NetworkConfig):
        return NetworkModel(load_network(settings.card, robot), settings.air_density, settings.precision)
    return Off()


def model_forces(model: AeroModel, axes: Array, v_air: Array) -> Array:
    """Force on each link (L, 3) [N] at its aerodynamic centre, from unit axes and relative air velocities (L, 3).

    A network needs more than that and has `whole_robot_forces`.
    """
    if isinstance(model, NetworkModel):
        raise TypeError("model is a network; expected one that looks at a link at a time")
    if isinstance(model, Axisymmetric):
        return axisymmetric_forces(model, axes, v_air)
    if isinstance(model, SphereCylinder):
        return sphere_cylinder_forces(model, axes, v_air)
    return jnp.zeros_like(v_air)


def whole_robot_forces(model: NetworkModel, robot: RobotModel, kin: Kinematics, wind: Array) -> Array:
    """Force on each link (L, 3) [N] at its aerodynamic centre, in a wind (3,) [m/s], inertial axes."""
    network = with_precision(model.network, jnp.float32 if model.precision == "f32" else wind.dtype)
    return network_forces(network, robot, kin, kin.joint_position, wind, model.air_density)
