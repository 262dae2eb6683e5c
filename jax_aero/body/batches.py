"""Batches of samples of which some need more than others: what is computed for a few at a time, and for which.

On a CPU a batch is computed `CHUNK` samples at a time, and only the samples that need it are gathered; elsewhere all at
once. JAX's own `vmap` of a `cond` computes both branches for every sample, and that of a `while_loop` goes on until the
slowest sample has ended.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jax.ad_checkpoint import checkpoint_name
from jax.custom_batching import custom_vmap
from jaxtyping import Bool, Int

from jax_aero.types import Array, where

CHUNK = 16
"""Number of samples per LAPACK call on a CPU; see `jax_aero.body.linalg`."""

ANSWER = "answer"
"""Name of what `keep_answer` marks."""

T = TypeVar("T")


def keep_answer(answer: T) -> T:
    """Mark an answer that was searched for: reverse mode stores it where it computes the rest of a tick again."""
    mark: Callable[..., Any] = checkpoint_name
    kept: T = jax.tree.map(lambda part: mark(part, ANSWER), answer)
    return kept


def compute_again(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose values reverse mode computes again, except answers, in place of storing them."""
    policy = jax.checkpoint_policies.save_only_these_names(ANSWER)
    again: Callable[..., Any] = jax.checkpoint(function, prevent_cse=False, policy=policy)
    return again


def with_batch_rule(one: Callable[..., Any], batch: Callable[..., Any]) -> Callable[..., Any]:
    """Return `one`, a function of one sample, with `batch` as its implementation under `vmap`; samples come first.

    Nested `vmap` gives one long batch. Differentiation of both functions is left to the caller.
    """
    return _with_batch_rule(one, lambda _: batch, lambda axes: jax.tree.map(lambda _: True, axes))


def _with_batch_rule(
    one: Callable[..., Any], batch_of: Callable[[Any], Callable[..., Any]], choose: Callable[[Any], Any]
) -> Callable[..., Any]:
    """Return a function of one sample; `choose` says which arguments get an axis where `vmap` maps over some.

    `batch_of` is given the same and returns the function of the batch.
    """
    single: Any = custom_vmap(one)

    def as_batch(axes: Any) -> Any:
        batched: Any = custom_vmap(batch_of(axes))

        def rule(size: int, is_batched: Any, *args: Any) -> Any:
            def count(x: Array, is_mapped: bool, has_axis: bool) -> int:
                return x.shape[int(is_mapped)] if has_axis else 0

            inner = max(jax.tree.leaves(jax.tree.map(count, args, tuple(is_batched), axes)))
            found = choose(jax.tree.map(lambda a, b: a or b, tuple(is_batched), axes))

            def flatten(x: Array, is_mapped: bool, has_axis: bool, is_chosen: bool) -> Array:
                if not is_chosen:
                    return x
                x = x if is_mapped else jnp.broadcast_to(x, (size, *x.shape))
                x = x if has_axis else jnp.broadcast_to(x[:, None], (size, inner, *x.shape[1:]))
                return x.reshape(-1, *x.shape[2:])

            flat = jax.tree.map(flatten, args, tuple(is_batched), axes, found)
            out = jax.tree.map(lambda x: x.reshape(size, -1, *x.shape[1:]), as_batch(found)(*flat))
            return out, jax.tree.map(lambda _: True, out)

        batched.def_vmap(rule)
        return batched

    def rule_of_single(size: int, is_batched: Any, *args: Any) -> Any:
        axes = choose(tuple(is_batched))

        def spread(x: Array, is_mapped: bool, is_chosen: bool) -> Array:
            return jnp.broadcast_to(x, (size, *jnp.shape(x))) if is_chosen and not is_mapped else x

        out = as_batch(axes)(*jax.tree.map(spread, args, tuple(is_batched), axes))
        return out, jax.tree.map(lambda _: True, out)

    single.def_vmap(rule_of_single)
    chosen: Callable[..., Any] = single
    return chosen


@custom_vmap
def any_in_batch(is_so: Bool[Array, ""]) -> Bool[Array, ""]:
    """Return whether it is so, under `vmap` in any sample: a `cond` by it computes one branch for the whole batch."""
    return is_so


@any_in_batch.def_vmap
def _any_in_batch(_size: int, _is_batched: Any, is_so: Bool[Array, " b"]) -> tuple[Bool[Array, ""], bool]:
    return any_in_batch(jnp.any(is_so)), False


def compute_where(is_due: Bool[Array, ""], make: Callable[[], T]) -> T:
    """Return what `make` computes where it is due and zeros elsewhere, without derivatives.

    In a batch on a CPU only the samples are computed for which it is due. What `make` uses and is the same for all
    samples, such as the robot, is not repeated.
    """
    program, shapes = jax.make_jaxpr(make, return_shape=True)()
    structure = jax.tree.structure(shapes)
    run = jax.jit(lambda *used: jax.core.eval_jaxpr(program.jaxpr, used))
    nothing = [jnp.zeros(shape.shape, shape.dtype) for shape in jax.tree.leaves(shapes)]

    def one(is_due: Array, nothing: list[Array], *used: Array) -> list[Array]:
        found: list[Array] = lax.cond(is_due, lambda: list(run(*used)), lambda: nothing)
        return found

    def batch_of(axes: Any) -> Callable[..., Any]:
        own = [place for place, is_own in enumerate(axes[2:]) if is_own]

        def compute(used: tuple[Array, ...], is_due: Array, parts: list[Array], before: list[Array]) -> list[Array]:
            replaced = dict(zip(own, parts, strict=True))
            made = list(run(*(replaced.get(place, each) for place, each in enumerate(used))))
            return where(is_due, made, before)

        def chunks(is_due: Array, nothing: list[Array], *used: Array) -> Any:
            parts = [used[place] for place in own]
            order, count = jnp.argsort(~is_due), jnp.sum(is_due)
            return map_in_chunks(partial(compute, used), (is_due, parts), nothing, order, count)

        def together(is_due: Array, nothing: list[Array], *used: Array) -> Any:
            parts, every = [used[place] for place in own], jax.vmap(partial(compute, used))
            return lax.cond(jnp.any(is_due), lambda: every(is_due, parts, nothing), lambda: nothing)

        return lambda *args: lax.platform_dependent(*args, cpu=chunks, default=together)

    def choose(axes: Any) -> Any:
        return (True, [True] * len(axes[1]), *axes[2:])

    chosen = _with_batch_rule(one, batch_of, choose)
    found: T = jax.tree.unflatten(structure, chosen(is_due, nothing, *lax.stop_gradient(program.consts)))
    return found


def map_in_chunks(
    one: Callable[..., Any],
    inputs: Any,
    out: Any,
    order: Int[Array, " k"],
    count: Int[Array, ""] | int,
) -> Any:
    """Replace the rows `order[:count]` of `out` by `one(*inputs, out)` of the same rows, `CHUNK` rows at a time.

    `order` has every row once.
    """
    chunk = min(CHUNK, order.shape[0])

    def map_chunk(k: Array, out: Any) -> Any:
        # The last slice is shifted to fit, so it may repeat earlier rows or include rows beyond `count`.
        def rows_of(leaf: Array) -> Array:
            return lax.dynamic_slice_in_dim(leaf, k * chunk, chunk)

        rows = rows_of(order)
        new = jax.vmap(one)(*jax.tree.map(lambda leaf: leaf[rows], inputs), jax.tree.map(rows_of, out))
        return jax.tree.map(lambda leaf, part: lax.dynamic_update_slice_in_dim(leaf, part, k * chunk, 0), out, new)

    # Sorted, since XLA writes scattered rows one by one.
    sorted_out = jax.tree.map(lambda leaf: leaf[order], out)
    ended = lax.fori_loop(0, (count + chunk - 1) // chunk, map_chunk, sorted_out)
    places = jnp.argsort(order)
    return jax.tree.map(lambda leaf: leaf[places], ended)


def in_chunks(one: Callable[..., T], chunk: int = CHUNK) -> Callable[..., T]:
    """Return a function of one sample that on a CPU computes a batch `chunk` samples at a time."""

    def batch(*inputs: Any) -> Any:
        def chunks(*inputs: Any) -> Any:
            return lax.map(lambda sample: one(*sample), inputs, batch_size=chunk)

        return lax.platform_dependent(*inputs, cpu=chunks, default=jax.vmap(one))

    return with_batch_rule(one, batch)
