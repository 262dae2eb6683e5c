"""Axisymmetric coefficients from observed wrenches: the alternative to a network, with 6 numbers a pair of links.

The wrench of the axisymmetric model is linear in its coefficients `w`, and so is an observer's estimate of it:

    minimise  Σ_k |A_k w + C_k c − ẑ_k|² / σ² + 1/(K Δt) (|(w − w₀) / a₀|² + |c / σ_c|²)

with rows `A` of each coefficient and the constants `c` of `jax_aero.train.wrench`. Left and right links share their
coefficients.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.aero.network import Network, baseline_areas, init_network
from jax_aero.body.mirror import opposite_indices
from jax_aero.body.robot import RobotModel
from jax_aero.train.wrench import Errors, ObservedWrenches, Windows, wrench
from jax_aero.types import Array

TERMS = 6
"""Coefficients of a link."""


def refit(
    robot: RobotModel, windows: Windows, objective: ObservedWrenches, start: Float[np.ndarray, "L 6"]
) -> Float[np.ndarray, "L 6"]:
    """Return the coefficients [m²] that windows and their difference from `start` make most likely."""
    pairs = _pairs(robot.aero_links.names)
    count = TERMS * len(pairs)
    units = np.zeros((count, robot.aero_links.count, TERMS), np.float32)
    for number, links in enumerate(pairs):
        for term in range(TERMS):
            units[TERMS * number + term, links, term] = 1.0
    columns = jax.jit(lambda window: _columns(objective, jnp.asarray(units), window))
    normal, right = np.zeros((count, count)), np.zeros(count)
    of_start = left(start, windows, objective).of_rows
    for number, one in enumerate(zip(*windows, strict=True)):
        # With the best constants the sum of squares and their prior is raw' free, raw' left.
        raw, free, e = (np.asarray(part, np.float64) for part in (*columns(Windows(*one)), of_start[number]))
        normal += np.einsum("tac,tad->cd", raw, free)
        right -= np.einsum("tac,ta->c", raw, e)
    prior = objective.rows_per_observation / objective.area**2
    change = np.linalg.solve(normal + prior * np.eye(count), right)
    coefficients: Float[np.ndarray, "L 6"] = np.asarray(start) + np.einsum("c,clt->lt", change, units)
    return coefficients


def as_network(robot: RobotModel, coefficients: Float[np.ndarray, "L 6"]) -> Network:
    """Return a network that is its baseline alone, so that a card holds coefficients."""
    bare = init_network(
        jax.random.key(0), robot, hidden=(), blocks=("wind",), baseline=jnp.asarray(coefficients, jnp.float32)
    )
    silent = jax.tree.map(jnp.zeros_like, bare.layers)
    return Network(**{**vars(bare), "layers": silent})


def _pairs(names: Any) -> list[list[int]]:
    """Return links that are opposite to each other, by number; a link in the middle alone."""
    return [sorted({link, int(other)}) for link, other in enumerate(opposite_indices(names)) if link <= other]


def _columns(
    objective: ObservedWrenches, units: Float[Array, "c L 6"], window: Windows
) -> tuple[Float[Array, "T 6 c"], Float[Array, "T 6 c"]]:
    """Return the observer's estimate of each coefficient, over its noise, and that without what constants explain."""

    def of_row(wind: Array, axes: Array, arms: Array, turn: Array, pressure: Array) -> Array:
        def of_unit(unit: Array) -> Array:
            return wrench(baseline_areas(unit, wind, axes), arms, turn, pressure)

        return jax.vmap(of_unit)(units).T

    total = jax.vmap(of_row)(window.wind, window.axes, window.arms, window.turn, window.pressure)
    seen = objective.filtered(total, jnp.zeros_like(total[0]))
    blank = window._replace(seen=jnp.zeros_like(window.seen))
    without = blank._replace(solve=jnp.zeros_like(window.solve))

    def left_of(column: Array) -> tuple[Array, Array]:
        return objective.left(column, without).of_rows, objective.left(column, blank).of_rows

    raw, free = jax.vmap(left_of, 2, 2)(seen)
    return raw, free


def left(coefficients: Float[np.ndarray, "L 6"], windows: Windows, objective: ObservedWrenches) -> Errors:
    """Return what coefficients [m²] leave of every window, (W, …)."""
    rows = jnp.asarray(coefficients, jnp.float32)

    @jax.jit
    def of_window(window: Windows) -> Errors:
        areas = jax.vmap(lambda wind, axes: baseline_areas(rows, wind, axes))(window.wind, window.axes)
        return objective.errors(areas, window)

    return objective.each(of_window, windows)
