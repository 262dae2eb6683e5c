"""Aerodynamic force on each link, from the velocity of the air relative to it.

    AeroConfig, RobotModel ──aero_model──► AeroModel;   Kinematics, wind ──link_forces──► LinkForces

The simulator's model and the controller's model are two values of one type. `v_air` is everywhere the velocity of the
*air* relative to the link (wind − link velocity), so drag points along `+v_air`. No model gives a moment about the
aerodynamic centre, where its force acts.
"""

from jax_aero.aero.axisymmetric import Axisymmetric, axisymmetric_forces
from jax_aero.aero.factors import ForceFactors, force_factors, weighted
from jax_aero.aero.link_forces import LinkConventions, generalised_aero_force, link_forces, scaled, wrench_about
from jax_aero.aero.model import AeroModel, NetworkModel, aero_model, model_forces
from jax_aero.aero.sphere_cylinder import SphereCylinder, sphere_cylinder_forces
from jax_aero.config import Off

__all__ = [
    "AeroModel",
    "Axisymmetric",
    "ForceFactors",
    "LinkConventions",
    "NetworkModel",
    "Off",
    "SphereCylinder",
    "aero_model",
    "axisymmetric_forces",
    "force_factors",
    "generalised_aero_force",
    "link_forces",
    "model_forces",
    "scaled",
    "sphere_cylinder_forces",
    "weighted",
    "wrench_about",
]
