"""One way to check a gradient: reverse mode, forward mode and a central difference along a random direction."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.measurements import measured

QUOTIENT = "the error of the quotient, step² f‴/6 + eps |f|/step, not of the derivative, which is held to 1e-9"


@pytest.fixture
def check_gradient() -> Callable[..., None]:
    return _check


def _check(function: Callable[..., Any], at: Any, *fixed: Any, tolerance: float = 1e-6, step: float = 1e-6) -> None:
    """`⟨w, J u⟩` of `function(at, *fixed)` three ways, for random `u` (scaled to the entries); all derivatives finite.

    One function compiles once for all the points it is checked at, so hand in what changes as `fixed`.
    """
    rng = np.random.default_rng(0)
    at = jax.tree.map(jnp.asarray, at)
    along = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)) * jnp.maximum(jnp.abs(x), 0.1), at)
    value, pushed, weights, gradient, difference = _derivatives(function)(at, along, step, *fixed)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves((pushed, gradient)))
    forward, reverse, finite = _dot(weights, pushed), _dot(gradient, along), _dot(weights, difference)
    # The sum may cancel, and a difference quotient carries the rounding of the values.
    scale = max(abs(finite), 1e-3 * _size(pushed), 1e-9 * _size(value), 1e-4)
    measured("forward - reverse", abs(forward - reverse), 1e-9 * scale)
    measured("forward - finite difference", abs(forward - finite), tolerance * scale, because=QUOTIENT)


@functools.cache
def _derivatives(function: Callable[..., Any]) -> Callable[..., Any]:
    @jax.jit
    def derivatives(x, u, step, *fixed):
        def f(x):
            return function(x, *fixed)

        value, pushed = jax.jvp(f, (x,), (u,))
        weights = jax.tree.map(lambda leaf: jnp.cos(jnp.arange(leaf.size).reshape(leaf.shape) + 0.3), value)
        gradient = jax.vjp(f, x)[1](weights)[0]
        # One copy of the function serves both sides of the difference.
        shifts = jnp.stack([step, -step])
        ahead_behind = jax.lax.map(lambda shift: f(jax.tree.map(lambda a, b: a + shift * b, x, u)), shifts)
        difference = jax.tree.map(lambda sides: (sides[0] - sides[1]) / (2 * step), ahead_behind)
        return value, pushed, weights, gradient, difference

    return derivatives


def _dot(a: Any, b: Any) -> float:
    return sum(float(jnp.vdot(x, y)) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def _size(tree: Any) -> float:
    return sum(float(jnp.sum(jnp.abs(leaf))) for leaf in jax.tree.leaves(tree))
