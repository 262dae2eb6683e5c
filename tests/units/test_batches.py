"""What is computed for a part of a batch is what each sample gives alone."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jax_aero.body.batches import CHUNK, compute_where, in_chunks, map_in_chunks

SIZE = 2 * CHUNK + 5
"""No multiple of a chunk."""


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_only_what_is_due_is_computed(share):
    """With arrays that all samples share; elsewhere there are zeros, also under two batches of which one varies."""
    rng = np.random.default_rng(0)
    is_due, x, y = jnp.asarray(rng.uniform(size=SIZE) < share), jnp.arange(SIZE * 1.0), jnp.arange(3.0)
    matrix = jnp.asarray(rng.integers(-5, 5, (3, 3)), x.dtype)

    def one(is_due, x, y):
        return compute_where(is_due, lambda: {"sum": matrix @ y + x, "count": jnp.asarray(x, jnp.int32)})

    alone = [one(*each, y) for each in zip(is_due, x, strict=True)]
    found = jax.jit(jax.vmap(one, in_axes=(0, 0, None)))(is_due, x, y)
    for index, expected in enumerate(alone):
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[index], b), found, expected)  # noqa: B023
        assert is_due[index] or not np.any(found["sum"][index])
    twice = jax.vmap(jax.vmap(one, in_axes=(0, None, None)), in_axes=(None, 0, None))(is_due, x[:4], y)
    for row in range(4):
        again = jax.vmap(one, in_axes=(0, None, None))(is_due, x[row], y)
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[row], b), twice, again)  # noqa: B023


def test_the_slowest_of_a_chunk_decides_how_long_it_takes():
    """Where others of a batch go on, a chunk that has ended is not computed again; derivatives do not pass."""
    counts = jnp.asarray(np.random.default_rng(1).integers(1, 20, SIZE))

    def one(count):
        return lax.while_loop(lambda state: state[0] < count, lambda state: (state[0] + 1, state[1] + 2.0), (0, 0.0))

    for index, (steps, total) in enumerate(zip(*jax.vmap(in_chunks(one, 4))(counts), strict=True)):
        assert (int(steps), float(total)) == (counts[index], 2.0 * counts[index])
    slope = jax.grad(lambda x: compute_where(jnp.array(True), lambda: x**2) + x)(3.0)
    assert slope == 1.0


def test_rows_are_replaced_in_any_order():
    """The first of them alone, and a last slice that does not fit."""
    rng = np.random.default_rng(2)
    order, out = jnp.asarray(rng.permutation(SIZE)), jnp.zeros(SIZE)
    count = CHUNK + 3
    given = jnp.arange(SIZE * 1.0)
    is_new = jnp.zeros(SIZE, bool).at[order[:count]].set(True)

    def one(x, is_new, before):
        return jnp.where(is_new, x, before)

    found = map_in_chunks(one, (given, is_new), out, order, count)
    np.testing.assert_array_equal(found, jnp.where(is_new, given, 0.0))
