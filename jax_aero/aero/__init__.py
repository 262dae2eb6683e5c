"""Aerodynamic force on each link, from the velocity of the air relative to it.

    AeroConfig, RobotModel ──aero_model──► AeroModel;   Kinematics, wind ──link_forces──► LinkForces

The simulator's and the controller's model are two values of one type. `v_air` is always the velocity of the *air*
relative to the link (wind − link velocity), so drag points along `+v_air`. No model gives a moment about the
aerodynamic centre, where the force acts. `AeroModel` is a protocol: any pytree with its method can be used.
"""

from jax_aero.aero.axisymmetric import Axisymmetric, axisymmetric_forces
from jax_aero.aero.factors import WeightedModel, weight_forces
from jax_aero.aero.link_forces import LinkConventions, generalised_aero_force, link_forces, wrench_about
from jax_aero.aero.model import NetworkModel, NoAero, ReadNetwork, aero_model
from jax_aero.aero.protocol import AeroModel, LinksInAir
from jax_aero.aero.sphere_cylinder import SphereCylinder, sphere_cylinder_forces

__all__ = [
    "AeroModel",
    "Axisymmetric",
    "LinkConventions",
    "LinksInAir",
    "NetworkModel",
    "NoAero",
    "ReadNetwork",
    "SphereCylinder",
    "WeightedModel",
    "aero_model",
    "axisymmetric_forces",
    "generalised_aero_force",
    "link_forces",
    "sphere_cylinder_forces",
    "weight_forces",
    "wrench_about",
]
