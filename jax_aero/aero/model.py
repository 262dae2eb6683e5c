"""Construction of an aerodynamic model from its configuration."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import assert_never

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero import config
from jax_aero.aero.axisymmetric import Axisymmetric
from jax_aero.aero.network import Network, network_forces, with_precision
from jax_aero.aero.network_card import load_network
from jax_aero.aero.protocol import AeroModel, LinksInAir
from jax_aero.aero.sphere_cylinder import sphere_cylinder_model
from jax_aero.body.robot import RobotModel
from jax_aero.types import Array, leaf, pytree, static


@pytree
class NoAero:
    """No aerodynamic force: the assumption of the baseline controller."""

    def forces(self, links: LinksInAir) -> Float[Array, "L 3"]:
        """Return zero for every link [N]."""
        return jnp.zeros_like(links.v_air)


@pytree
class NetworkModel:
    """A neural network of wind and posture that gives the forces on all links at once."""

    network: Network
    air_density: Float[Array, ""]
    """[kg/m³]."""
    precision: config.Precision = static()
    """Precision of the network's weighted sums: single, or that of the flight."""

    def forces(self, links: LinksInAir) -> Float[Array, "L 3"]:
        """Return the force on each link [N], inertial axes; see `network_forces`."""
        kin, wind = links.kinematics, links.wind
        network = with_precision(self.network, jnp.float32 if self.precision == "f32" else wind.dtype)
        return network_forces(network, links.robot, kin, kin.joint_position, wind, self.air_density)


ReadNetwork = Callable[[str | PathLike[str], RobotModel], Network]


def aero_model(settings: config.AeroConfig, robot: RobotModel, read_network: ReadNetwork = load_network) -> AeroModel:
    """Build the configured model. Call it once, outside loops, since it computes interpolation tables.

    Raises
    ------
    ValueError
        If the robot lacks the coefficient set, or if a network's card or weights are invalid.
    """
    match settings:
        case config.OffAeroConfig():
            return NoAero()
        case config.AxisymmetricAeroConfig():
            sets = robot.aero_links.coefficients
            if robot.aero_links.count and settings.coefficients not in sets:
                stated = f"coefficients is `{settings.coefficients}`"
                known = ", ".join(sorted(sets)) or 'none; expected another model, such as "sphere_cylinder"'
                raise ValueError(f"{stated}; {robot.name} has {known}")
            return Axisymmetric(
                k_a=0.5 * leaf(settings.air_density), areas=sets.get(settings.coefficients, leaf([]).reshape(0, 6))
            )
        case config.SphereCylinderAeroConfig():
            return sphere_cylinder_model(settings, robot.aero_links)
        case config.NetworkAeroConfig():
            return NetworkModel(read_network(settings.card, robot), leaf(settings.air_density), settings.precision)
        case _:
            assert_never(settings)
