"""Angle of attack of a link, and the direction of its normal force.

Equation M19 of `docs/model.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.spatial import cross, safe_norm
from jax_aero.types import Array

SPEED_EPSILON = 1e-9
"""Added to the speed in the cosine of the angle of attack [m/s]; the published value."""


class Attack(NamedTuple):
    """Angle between the link's axis and the *upstream* direction, as cosine and sine, and the speed of the air."""

    speed: Float[Array, " L"]
    """[m/s]."""
    cos: Float[Array, " L"]
    """1 when the air comes from where the axis points."""
    sin: Float[Array, " L"]
    """Not negative."""


def attack(axes: Float[Array, "L 3"], v_air: Float[Array, "L 3"]) -> Attack:
    """Angles of attack of links with unit axes in air of relative velocity, without `acos`.

        cos α = −k̂·v / (|v| + ε),   sin α = √(|v × k̂|² + ε (2|v| + ε)) / (|v| + ε),   ε = 1e-9 m/s

    The sine is `(|v| + ε)² − (k̂·v)²` by Lagrange's identity, free of the cancellation of `1 − cos²`. The ε that keeps
    the quotient finite at rest also keeps zero out of the square root, so derivatives are finite for wind along the
    axis and for no wind at all, where α = 90°.
    """
    speed = safe_norm(v_air)
    regular = speed + SPEED_EPSILON
    across = jnp.sum(cross(v_air, axes) ** 2, -1) + SPEED_EPSILON * (speed + regular)
    cos = jnp.clip(-jnp.sum(axes * v_air, -1) / regular, -1.0, 1.0)
    return Attack(speed, cos, jnp.minimum(jnp.sqrt(across) / regular, 1.0))


def normal_directions(axes: Float[Array, "L 3"], v_air: Float[Array, "L 3"]) -> Float[Array, "L 3"]:
    """`(v × k̂) × v`: across the wind, towards the axis, of length `|v|² sin α`.

    The double cross product, not `|v|² k̂ − (v·k̂) v`: nothing cancels when wind and axis align.
    """
    return cross(cross(v_air, axes), v_air)
