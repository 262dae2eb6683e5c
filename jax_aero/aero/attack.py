"""Angle of attack of a link, and the direction of its normal force.

Equation M19 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.body.spatial import cross, safe_norm
from jax_aero.types import Array

SPEED_EPSILON = 1e-9
"""Regularisation added to the speed in the cosine of the angle of attack [m/s]; the published value."""


class Attack(NamedTuple):
    """Cosine and sine of the angle between the link's axis and the *upstream* direction, and the air speed."""

    speed: Float[Array, " L"]
    """Speed of the air relative to the link [m/s]."""
    cos: Float[Array, " L"]
    """cos α; 1 when the air comes from the direction of the axis."""
    sin: Float[Array, " L"]
    """sin α ≥ 0."""


def attack(axes: Float[Array, "L 3"], v_air: Float[Array, "L 3"]) -> Attack:
    """Return the angles of attack of links with unit axes, from the velocity of the air [m/s], without `acos`.

        cos α = −k̂·v / (|v| + ε),   sin α = √(|v × k̂|² + ε (2|v| + ε)) / (|v| + ε),   ε = 1e-9 m/s

    The sine uses `(|v| + ε)² − (k̂·v)²`, rewritten by Lagrange's identity to avoid the cancellation of `1 − cos²`. ε
    keeps the quotient finite at rest and the argument of the square root positive, so derivatives are finite for wind
    along the axis and without wind, where α = 90°.
    """
    speed = safe_norm(v_air)
    regular = speed + SPEED_EPSILON
    across = jnp.sum(cross(v_air, axes) ** 2, -1) + SPEED_EPSILON * (speed + regular)
    cos = jnp.clip(-jnp.sum(axes * v_air, -1) / regular, -1.0, 1.0)
    return Attack(speed, cos, jnp.minimum(jnp.sqrt(across) / regular, 1.0))


def normal_directions(axes: Float[Array, "L 3"], v_air: Float[Array, "L 3"]) -> Float[Array, "L 3"]:
    """Return `(v × k̂) × v`: normal to the wind, on the side of the axis, of length `|v|² sin α`.

    Computed as a double cross product, since `|v|² k̂ − (v·k̂) v` suffers cancellation when wind and axis align.
    """
    across: Array = cross(cross(v_air, axes), v_air)
    return across
