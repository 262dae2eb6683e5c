"""The paper's axisymmetric model: drag and normal force areas of each link, fitted to CFD.

Equation M20 of `docs/model`.
"""

from __future__ import annotations

from jaxtyping import Float

from jax_aero.aero.attack import attack, normal_directions
from jax_aero.aero.protocol import LinksInAir
from jax_aero.types import Array, pytree


@pytree
class Axisymmetric:
    """Axisymmetric model of a set of links."""

    k_a: Float[Array, ""]
    """`ρ/2` [kg/m³]."""
    areas: Float[Array, "L 6"]
    """Coefficients `w0 .. w5` [m²]."""

    def forces(self, links: LinksInAir) -> Float[Array, "L 3"]:
        """Return the force on each link [N], inertial axes; see `axisymmetric_forces`."""
        return axisymmetric_forces(self, links.axes, links.v_air)


def axisymmetric_forces(
    model: Axisymmetric, axes: Float[Array, "L 3"], v_air: Float[Array, "L 3"]
) -> Float[Array, "L 3"]:
    """Return the forces on the links [N], inertial axes; zero at rest.

        C_D A = w₀ + w₁ cos α + w₂ sin² α + w₃ sin³ α + w₄ cos³ α
        F = k_a ( |v| C_D A v + w₅ sin α cos α (v × k̂) × v ),   k_a = ρ/2

    Source: paper, Methods, eq. `aero-force-model`, with `C_N A = w₅ sin² α cos α`. The printed division by sin α is
    cancelled, so the force is finite for wind along the axis. The paper's `v_a` is `−v`.
    """
    speed, cos, sin = attack(axes, v_air)
    w0, w1, w2, w3, w4, w5 = (model.areas[:, i] for i in range(6))
    drag_area = w0 + cos * (w1 + w4 * cos * cos) + sin * sin * (w2 + w3 * sin)
    normal = (w5 * sin * cos)[:, None] * normal_directions(axes, v_air)
    return model.k_a * ((speed * drag_area)[:, None] * v_air + normal)
