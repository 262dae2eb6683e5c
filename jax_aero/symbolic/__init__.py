"""A third, independent derivation of the model: from energy, momentum and their symbolic derivatives, in CasADi.

Nothing here is translated from Rust or JAX. The three implementations share a robot's numbers but no expressions,
so that a sign error passes `tests/parity` only if it is made three times.

    robot (numbers) ► spatial ► kinematics (tree) ► dynamics (energy) ► aero ► momentum ► contact, trim, trajectory

Expressions are `casadi.SX`; results are NumPy arrays.
"""

from jax_aero.symbolic.momentum import MomentumModel, Terms
from jax_aero.symbolic.robot import Robot, load_robot

__all__ = ["MomentumModel", "Robot", "Terms", "load_robot"]
