"""Adam, with decoupled weight decay."""

from __future__ import annotations

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from jax_aero.types import Array, pytree

Tree = TypeVar("Tree")


@pytree
class AdamState:
    """First and second moments of the gradient, shaped like the parameters."""

    mean: Any
    square: Any
    count: Int[Array, ""]
    """Number of steps taken."""


def adam_start(parameters: Any) -> AdamState:
    """Return the state before the first step."""
    zeros = jax.tree.map(jnp.zeros_like, parameters)
    return AdamState(zeros, zeros, jnp.zeros((), jnp.int32))


def adam_step(
    state: AdamState,
    parameters: Tree,
    gradient: Tree,
    rate: Float[Array, ""],
    *,
    beta1: float = 0.9,
    beta2: float = 0.999,
    epsilon: float = 1e-8,
    weight_decay: float = 0.0,
) -> tuple[AdamState, Tree]:
    """Take one step of size `rate`.

        m ← β₁ m + (1 − β₁) g,   v ← β₂ v + (1 − β₂) g²
        θ ← θ − rate ( m / (1 − β₁ᵗ) / (√(v / (1 − β₂ᵗ)) + ε) + decay θ )

    Source: Kingma and Ba 2015, algorithm 1. The decay follows Loshchilov and Hutter 2019 and applies to matrices only,
    not to biases, whose leaves have one dimension fewer.
    """
    count = state.count + 1
    mean = jax.tree.map(lambda m, g: beta1 * m + (1.0 - beta1) * g, state.mean, gradient)
    square = jax.tree.map(lambda v, g: beta2 * v + (1.0 - beta2) * g * g, state.square, gradient)
    dtype = jnp.result_type(rate)
    correct1 = (1.0 - jnp.asarray(beta1, dtype) ** count.astype(dtype)).astype(dtype)
    correct2 = (1.0 - jnp.asarray(beta2, dtype) ** count.astype(dtype)).astype(dtype)
    most = max(leaf.ndim for leaf in jax.tree.leaves(parameters))

    def move(theta: Array, m: Array, v: Array) -> Array:
        step = (m / correct1) / (jnp.sqrt(v / correct2) + epsilon)
        decay = weight_decay * theta if weight_decay and theta.ndim == most else 0.0
        return theta - rate * (step + decay)

    return AdamState(mean, square, count), jax.tree.map(move, parameters, mean, square)
