"""Solution of positive definite systems of 20 to 30 rows, singly and in batches.

On a CPU, LAPACK is called for few samples at a time. jaxlib 0.10 splits larger batches over its thread pool and blocks
a thread of that pool until all parts are done, so two independent calls can deadlock (observed with 64 samples and two
threads; up to 32 are not split). Small chunks also stay in the cache.
"""

from __future__ import annotations

from functools import partial
from typing import cast

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Bool, Float

from jax_aero.body.batches import in_chunks, map_in_chunks, with_batch_rule
from jax_aero.types import Array

dot = partial(jnp.matmul, precision="highest")
"""Matrix product in full precision on every device."""


def solve_positive_definite(a: Float[Array, "u u"], b: Float[Array, "u k"]) -> Float[Array, "u k"]:
    """Return `A⁻¹ B` for a symmetric positive definite A; NaN if A is not positive definite.

    Differentiable in both modes and to any order.
    """
    x: Array = lax.custom_linear_solve(lambda x: dot(a, x), b, solve=lambda _, b: _solve(a, b), symmetric=True)
    return x


def invert(
    a: Float[Array, "u u"], unless: tuple[Bool[Array, ""], Float[Array, "u u"]] | None = None
) -> Float[Array, "u u"]:
    """Return `A⁻¹` for a symmetric positive definite A; NaN if A is not positive definite.

    `unless` says whether it is known already, and what it then is: on a CPU only the others of a batch are computed.
    Differentiable in both modes and to any order.
    """
    return _invert(a, unless) if a.size else a


@jax.custom_jvp
def _invert(a: Array, unless: tuple[Array, Array] | None) -> Array:
    inverse: Array = _inverse(a) if unless is None else _inverse_unless(*unless, a)
    return inverse


@_invert.defjvp
def _invert_jvp(primals, tangents):  # type: ignore[no-untyped-def]
    inverse = _invert(*primals)
    return inverse, -dot(inverse, dot(tangents[0], inverse))


def cholesky(a: Float[Array, "u u"]) -> Float[Array, "u u"]:
    """Return the lower factor L of `A = L Lᵀ`; NaN if A is not positive definite. A CPU batch has at most `CHUNK`."""
    return lax.linalg.cholesky(a, symmetrize_input=False)


def solve_factored(factor: Float[Array, "u u"], b: Float[Array, "u k"]) -> Float[Array, "u k"]:
    """Return `A⁻¹ B` from the factor of A. A CPU batch has at most `CHUNK`."""
    lower = partial(lax.linalg.triangular_solve, factor, left_side=True, lower=True)
    return lower(lower(b), transpose_a=True)


# --- batches ------------------------------------------------------------------------------------------------------


_solve = in_chunks(lambda a, b: solve_factored(cholesky(a), b))


def _inverse_one(a: Array) -> Array:
    """From `A = L Lᵀ`: `A⁻¹ = L⁻ᵀ L⁻¹`."""
    eye = jnp.eye(a.shape[0], dtype=a.dtype)
    inverse_factor = lax.linalg.triangular_solve(cholesky(a), eye, left_side=True, lower=True)
    return dot(inverse_factor.T, inverse_factor)


_inverse = in_chunks(_inverse_one)


def _inverse_unless_one(is_known: Array, known: Array, a: Array) -> Array:
    inverse: Array = lax.cond(is_known, lambda: known, lambda: _inverse_one(a))
    return inverse


def _inverse_unless_batch(is_known: Array, known: Array, a: Array) -> Array:
    def chunks(is_known: Array, known: Array, a: Array) -> Array:
        def one(is_known: Array, a: Array, known: Array) -> Array:
            return jnp.where(is_known, known, _inverse_one(a))

        return cast(Array, map_in_chunks(one, (is_known, a), known, jnp.argsort(is_known), jnp.sum(~is_known)))

    every = jax.vmap(_inverse_unless_one)
    return cast(Array, lax.platform_dependent(is_known, known, a, cpu=chunks, default=every))


_inverse_unless = with_batch_rule(_inverse_unless_one, _inverse_unless_batch)
