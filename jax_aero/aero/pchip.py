"""Shape-preserving cubic interpolation of a table, in JAX."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.types import Array, pytree


@pytree
class Pchip:
    """Piecewise cubic Hermite interpolant: monotone where the table is monotone, constant beyond its ends.

    Source: Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984), the method of MATLAB's and scipy's `pchip`.
    """

    x: Float[Array, " k"]
    """Abscissae, increasing."""
    y: Float[Array, " k"]
    slopes: Float[Array, " k"]


def pchip(x: Float[Array, " k"], y: Float[Array, " k"]) -> Pchip:
    """Return the interpolant of a table."""
    from scipy.interpolate import PchipInterpolator  # SciPy is loaded only when needed

    return Pchip(*map(jnp.asarray, (x, y, PchipInterpolator(x, y).derivative()(x))))


def interpolate(table: Pchip, x: Float[Array, " *batch"]) -> Float[Array, " *batch"]:
    """Return the values at `x`, an array of any shape; beyond an end of the table, the value at that end."""
    inside = jnp.clip(x, table.x[0], table.x[-1])
    below = _segment(table, inside)
    h = table.x[below + 1] - table.x[below]
    a, b = table.slopes[below], table.slopes[below + 1]
    secant = (table.y[below + 1] - table.y[below]) / h
    s = inside - table.x[below]
    c2, c3 = (3.0 * secant - 2.0 * a - b) / h, (a + b - 2.0 * secant) / (h * h)
    return table.y[below] + s * (a + s * (c2 + s * c3))


def _segment(table: Pchip, x: Array) -> Array:
    """Index of the last abscissa below; for short tables comparing with all points is faster than a search."""
    above = jnp.sum(x[..., None] >= table.x, axis=-1)
    return jnp.clip(above - 1, 0, table.x.shape[0] - 2)
