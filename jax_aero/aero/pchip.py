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
    """Return the interpolant of a table with k ≥ 3 points.

    Interior slopes are the weighted harmonic mean of the neighbouring secants, or zero where these change sign; end
    slopes follow the three-point formula, limited to prevent overshoot.
    """
    x, y = jnp.asarray(x), jnp.asarray(y)
    h = jnp.diff(x)
    secant = jnp.diff(y) / h
    left, right = secant[:-1], secant[1:]
    w_left, w_right = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    agree = left * right > 0.0
    mean = (w_left + w_right) / (w_left / jnp.where(agree, left, 1.0) + w_right / jnp.where(agree, right, 1.0))
    first = _end_slope(h[0], h[1], secant[0], secant[1])
    last = _end_slope(h[-1], h[-2], secant[-1], secant[-2])
    return Pchip(x, y, jnp.concatenate([first[None], jnp.where(agree, mean, 0.0), last[None]]))


def _end_slope(h_near: Array, h_next: Array, near: Array, following: Array) -> Array:
    """Three-point slope at an end, limited to the sign and to three times the value of the nearest secant."""
    slope = ((2.0 * h_near + h_next) * near - h_near * following) / (h_near + h_next)
    limited = jnp.where((near * following < 0.0) & (jnp.abs(slope) > 3.0 * jnp.abs(near)), 3.0 * near, slope)
    return jnp.where(slope * near <= 0.0, 0.0, limited)


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
