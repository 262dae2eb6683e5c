"""Model of links as spheres and finite cylinders, with drag from the literature at the Reynolds number of each link.

Equations M21 and M22 of `docs/model`.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.aero.attack import attack, normal_directions
from jax_aero.aero.pchip import Pchip, interpolate, pchip
from jax_aero.aero.protocol import LinksInAir
from jax_aero.body.robot import AeroLinks
from jax_aero.config import SphereCylinderAeroConfig
from jax_aero.types import Array, leaf, pytree


@pytree
class SphereCylinder:
    """Sphere and cylinder model of a set of links; every array except the tables has one entry per link."""

    half_density_area: Float[Array, " L"]
    """`ρ A/2` [kg/m], with the reference area A."""
    reynolds_per_speed: Float[Array, " L"]
    """Reynolds number per air speed, `ρ d/μ` [s/m]."""
    is_sphere: Bool[Array, " L"]
    """Whether the link is a sphere."""
    crosswind: Float[Array, " L"]
    """Factor φ(d/l) on the crosswind drag of a finite cylinder."""
    axial: Float[Array, " L"]
    """Axial drag coefficient on the area `d l`, relative to the crosswind drag of an infinite cylinder."""
    cylinder: Pchip
    """Crosswind drag coefficient of an infinite cylinder, by Reynolds number."""
    sphere: Pchip
    """Drag coefficient of a sphere, by Reynolds number."""
    drag_below_reynolds_10: Float[Array, ""]

    def forces(self, links: LinksInAir) -> Float[Array, "L 3"]:
        """Return the force on each link [N], inertial axes; see `sphere_cylinder_forces`."""
        return sphere_cylinder_forces(self, links.axes, links.v_air)


def sphere_cylinder_model(config: SphereCylinderAeroConfig, links: AeroLinks) -> SphereCylinder:
    """Return the model with the constants of every link."""
    c, d, length = config.cylinder, jnp.asarray(links.diameters), jnp.asarray(links.lengths)
    is_sphere = np.array(links.is_sphere)
    cylinder = pchip(leaf(c.reynolds), leaf(c.crosswind_drag))
    finite = pchip(leaf(c.diameter_over_length), leaf(c.finite_length_drag))
    axial = pchip(leaf(c.length_over_diameter), leaf(c.axial_drag))
    reference_drag = jnp.interp(leaf(c.reference_reynolds), cylinder.x, cylinder.y)
    # π/4 d/l converts the axial coefficient from the area π d²/4 to d l.
    return SphereCylinder(
        half_density_area=0.5 * config.air_density * length * d * jnp.where(is_sphere, 0.25 * jnp.pi, 1.0),
        reynolds_per_speed=config.air_density * d / config.dynamic_viscosity,
        is_sphere=jnp.asarray(is_sphere),
        crosswind=interpolate(finite, d / length) / max(c.finite_length_drag),
        axial=interpolate(axial, length / d) / max(c.axial_drag) * (0.25 * jnp.pi) * (d / length) / reference_drag,
        cylinder=cylinder,
        sphere=pchip(leaf(config.sphere.reynolds), leaf(config.sphere.drag)),
        drag_below_reynolds_10=leaf(config.sphere.drag_below_reynolds_10),
    )


def sphere_cylinder_forces(
    model: SphereCylinder, axes: Float[Array, "L 3"], v_air: Float[Array, "L 3"]
) -> Float[Array, "L 3"]:
    """Return the forces on the links [N], inertial axes; zero at rest.

        cylinder: C90 = C_cyl(Re) φ(d/l),   C0 = π/4 d/l χ(l/d) C_cyl(Re)/C_cyl(Re_ref)
                  F = ρ d l/2 ( (C0 + (C90 − C0) sin³ α) |v| v + C90 sin α cos α (v × k̂) × v )
        sphere:   F = ρ π d l/8 C_sph(Re) |v| v
        Re = ρ |v| d/μ

    Source: the published controller's alternative to the axisymmetric model; tables from Wieselsberger (1922),
    Kritzinger (2004) and Achenbach (1972). Beyond the ends of a table its end values are used.
    """
    speed, cos, sin = attack(axes, v_air)
    reynolds = model.reynolds_per_speed * speed
    on_cylinder = interpolate(model.cylinder, reynolds)
    drag = jnp.where(
        model.is_sphere,
        sphere_drag(model, reynolds),
        on_cylinder * (model.axial + (model.crosswind - model.axial) * sin**3),
    )
    normal = jnp.where(model.is_sphere, 0.0, on_cylinder * model.crosswind * sin * cos)
    forces = (drag * speed)[:, None] * v_air + normal[:, None] * normal_directions(axes, v_air)
    return model.half_density_area[:, None] * forces


def sphere_drag(model: SphereCylinder, reynolds: Float[Array, " L"]) -> Float[Array, " L"]:
    """Return the drag coefficient of a sphere, on the area `π d²/4`.

        C = 24/Re (1 + 0.150 Re^0.681) + 0.407/(1 + 8710/Re)   from Re = 10 to the table

    Source: Brown and Lawler (2003). Below Re = 10 the coefficient is constant, so that the force vanishes at rest with
    the square of the speed; at higher Re it follows the table of Achenbach (1972), then its last value.
    """
    is_slow = reynolds < 10.0
    re = jnp.where(is_slow, 10.0, reynolds)  # avoids powers of zero: both branches are differentiated
    formula = 24.0 / re * (1.0 + 0.150 * re**0.681) + 0.407 / (1.0 + 8710.0 / re)
    fast = jnp.where(re <= model.sphere.x[0], formula, interpolate(model.sphere, re))
    return jnp.where(is_slow, model.drag_below_reynolds_10, fast)
