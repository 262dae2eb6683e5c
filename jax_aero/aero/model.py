"""Which aerodynamic model: the one place that tells them apart."""

from __future__ import annotations

from typing import TypeAlias

import jax.numpy as jnp

from jax_aero import config
from jax_aero.aero.axisymmetric import Axisymmetric, axisymmetric_forces
from jax_aero.aero.sphere_cylinder import SphereCylinder, sphere_cylinder_forces, sphere_cylinder_model
from jax_aero.robot import RobotModel
from jax_aero.types import Array, pytree


@pytree
class Off:
    """No aerodynamic force: what the baseline controller assumes."""


AeroModel: TypeAlias = Off | Axisymmetric | SphereCylinder
"""An aerodynamic model of a robot's links; its numbers are leaves."""


def aero_model(settings: config.AeroConfig, robot: RobotModel) -> AeroModel:
    """Build the model that the configuration asks for. Do it once, outside loops: tables are worked out here.

    Raises
    ------
    ValueError
        If the robot lacks the coefficient set.
    """
    if isinstance(settings, config.AxisymmetricConfig):
        sets = robot.aero_links.coefficients
        if settings.coefficients not in sets:
            raise ValueError(f"coefficients is `{settings.coefficients}`; {robot.name} has {', '.join(sorted(sets))}")
        return Axisymmetric(k_a=0.5 * settings.air_density, areas=sets[settings.coefficients])
    if isinstance(settings, config.SphereCylinderConfig):
        return sphere_cylinder_model(settings, robot.aero_links)
    return Off()


def model_forces(model: AeroModel, axes: Array, v_air: Array) -> Array:
    """Force on each link (L, 3) [N] at its aerodynamic centre, from unit axes and relative air velocities (L, 3)."""
    if isinstance(model, Axisymmetric):
        return axisymmetric_forces(model, axes, v_air)
    if isinstance(model, SphereCylinder):
        return sphere_cylinder_forces(model, axes, v_air)
    return jnp.zeros_like(v_air)
