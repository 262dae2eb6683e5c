"""The box-constrained quadratic program of both controllers: solution, certificate, derivative.

```text
minimise  ½ xᵀ H x + gᵀ x   subject to   lower ≤ x ≤ upper,     H symmetric positive definite
```

One problem is solved per call; use `vmap` for batches. The method is a monotone primal active set, started from the
working set of the previous tick: undisturbed flight needs one pass, a saturated problem about a third of a pass per
variable. A pass is a fixed set of dense operations, so a batch computes it together; on a CPU the problems that need
more passes are gathered, so that the batch does not wait for its slowest.

Derivative: a small change of the data does not change the active set, so `x` solves a linear system (implicit function
theorem), in both modes and to any order. For the exceptions see `solve`.

An accuracy of 1e-9 requires float64, since `H` of the flight has a condition number of about 2e8.

Equation M66 of `docs/model`.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from jax_aero.body.batches import CHUNK, keep_answer, map_in_chunks, with_batch_rule
from jax_aero.body.linalg import cholesky, dot, solve_factored, solve_positive_definite
from jax_aero.types import Array, where

Dtype: TypeAlias = np.dtype[Any] | type[np.floating[Any]]

PASSES_PER_VARIABLE = 10
"""Passes allowed per variable, as in the Rust crate; flight problems have needed less than one."""

SOLVED, ITERATION_LIMIT, NOT_POSITIVE_DEFINITE, INFEASIBLE_BOUNDS, NON_FINITE, INACCURATE = range(6)
"""Status codes, equal to those of the Rust crate's `QpStatus`."""


class BoxQp(NamedTuple):
    """Data of one problem."""

    h: Float[Array, "u u"]
    """Hessian, taken to be exactly symmetric."""
    g: Float[Array, " u"]
    """Linear term."""
    lower: Float[Array, " u"]
    """Lower bounds; -inf where there is none."""
    upper: Float[Array, " u"]
    """Upper bounds; equal to the lower bound for a fixed variable."""


class WarmStart(NamedTuple):
    """Starting point of a solve: the answer of the previous one."""

    x: Float[Array, " u"]
    """Point, not necessarily feasible."""
    side: Int[Array, " u"]
    """Working set: -1 held at the lower bound, 1 at the upper, 0 free."""


class QpAnswer(NamedTuple):
    """Minimiser and its accuracy."""

    x: Float[Array, " u"]
    """The minimiser, inside the bounds."""
    side: Int[Array, " u"]
    """Its working set, as in `WarmStart`."""
    kkt: Float[Array, ""]
    """`kkt_residual` of x."""
    status: Int[Array, ""]
    """Status code; 0 is solved."""
    iterations: Int[Array, ""]
    """Number of factorisations."""

    @property
    def warm_start(self) -> WarmStart:
        """Return the starting point of the next solve."""
        return WarmStart(self.x, self.side)


def cold_start(n: int, dtype: Dtype) -> WarmStart:
    """Return a start at zero with all variables free."""
    return WarmStart(jnp.zeros(n, dtype), jnp.zeros(n, jnp.int8))


def kkt_tolerance(dtype: Dtype) -> float:
    """Return the largest `kkt_residual` of a solved problem: √ε in float64 as in the crate, otherwise 1e-5."""
    return float(np.sqrt(np.finfo(np.float64).eps)) if np.finfo(dtype).bits == 64 else 1e-5


def kkt_residual(qp: BoxQp, x: Float[Array, " u"]) -> Float[Array, ""]:
    """Return the violation of the optimality conditions by `x`, dimensionless.

    ```text
    y_i = √H_ii x_i,   q_i = (H x + g)_i / √H_ii
    kkt = max_i | y_i − clamp(y_i − q_i, √H_ii lower_i, √H_ii upper_i) |  /  max(1, |g/√H_ii|_∞, |y|_∞)
    ```

    Zero exactly at the minimiser. NaN if data are not finite or the diagonal is not positive.
    """
    root = jnp.sqrt(jnp.diagonal(qp.h))
    y, q, g = root * x, (dot(qp.h, x) + qp.g) / root, qp.g / root
    gap = y - jnp.clip(y - q, root * qp.lower, root * qp.upper)
    residual = _max_abs(gap) / jnp.maximum(1.0, jnp.maximum(_max_abs(g), _max_abs(y)))
    # Minimum and maximum may ignore NaN, so it is tested separately.
    finite = jnp.all(jnp.isfinite(q) & jnp.isfinite(y) & ~jnp.isnan(qp.lower) & ~jnp.isnan(qp.upper))
    return jnp.where(finite, residual, jnp.nan)


def solve(qp: BoxQp, start: WarmStart | None = None) -> QpAnswer:
    """Return the minimiser of `qp`, differentiable with respect to all its data.

    Derivative: `H_FF dx_F = −(dg + dH x + H dx_held)_F` over the free variables F. A held variable moves with its
    bound, a fixed one (lower = upper) with the bound that its gradient presses it against. A variable at a bound with
    multiplier zero (degenerate) counts as held: of the two one-sided derivatives this is that of the side on which the
    bound is active. Status, residual and starting point have no derivative; that of an unsolved problem is zero.
    """
    if qp.g.shape[0] == 0:  # a robot without joints or without jets has no variables
        nothing = cold_start(0, qp.g.dtype)
        solved, zero = jnp.full((), SOLVED, jnp.int32), jnp.zeros((), qp.g.dtype)
        return QpAnswer(nothing.x, nothing.side, zero, solved, jnp.zeros((), jnp.int32))
    if start is None:
        start = cold_start(qp.g.shape[0], qp.g.dtype)
    return _minimise(qp, jax.tree.map(lax.stop_gradient, start))


@jax.custom_jvp
def _minimise(qp: BoxQp, start: WarmStart) -> QpAnswer:
    scale = _jacobi_scale(qp.h)
    scaled = BoxQp(qp.h * scale[:, None] * scale[None], qp.g * scale, qp.lower / scale, qp.upper / scale)
    fault = _fault(scaled)
    search = _begin(scaled, WarmStart(start.x / scale, start.side), fault)
    search = _active_set(scaled, search)
    x = jnp.where(fault == ITERATION_LIMIT, jnp.clip(search.y * scale, qp.lower, qp.upper), start.x)
    kkt = kkt_residual(qp, x)
    accepted = kkt <= kkt_tolerance(x.dtype)
    status = jnp.where((search.status == SOLVED) & ~accepted, INACCURATE, search.status)
    kkt = jnp.where(status == INFEASIBLE_BOUNDS, jnp.nan, kkt)
    return QpAnswer(x, search.side, kkt, status, search.iterations)


@_minimise.defjvp
def _minimise_jvp(primals, tangents):  # type: ignore[no-untyped-def]
    (qp, start), (d_qp, _) = primals, tangents
    answer = keep_answer(_minimise(qp, start))
    none: Any = partial(np.zeros, dtype=jax.dtypes.float0)
    side, status, iterations = (none(code.shape) for code in (answer.side, answer.status, answer.iterations))
    return answer, QpAnswer(_derivative(qp, answer, d_qp), side, jnp.zeros_like(answer.kkt), status, iterations)


@jax.custom_jvp
def minimiser(qp: BoxQp, answer: QpAnswer) -> Float[Array, " u"]:  # noqa: ARG001
    """Return the minimiser of an answer to `qp` that was found without derivatives, with those of `solve`."""
    return answer.x


@minimiser.defjvp
def _minimiser_jvp(primals, tangents):  # type: ignore[no-untyped-def]
    qp, answer = primals
    return minimiser(qp, answer), _derivative(qp, answer, tangents[0])


def _derivative(qp: BoxQp, answer: QpAnswer, d_qp: BoxQp) -> Array:
    """Return the change of the minimiser with the data, as `solve` states it."""
    x, is_solved = answer.x, answer.status == SOLVED
    pressed_up = dot(qp.h, x) + qp.g < 0
    at_upper = jnp.where(qp.lower == qp.upper, pressed_up, x >= qp.upper)
    free = (x > qp.lower) & (x < qp.upper) & is_solved
    d_bound = jnp.where(is_solved, jnp.where(at_upper, d_qp.upper, d_qp.lower), 0.0)
    d_held = jnp.where(free, 0.0, d_bound)
    right = jnp.where(free, -(d_qp.g + dot(d_qp.h, x) + dot(qp.h, d_held)), 0.0)
    # Scaling by the diagonal makes the factor as accurate as that of the solution.
    scale = jnp.where(free, lax.rsqrt(jnp.where(free, jnp.diagonal(qp.h), 1.0)), 1.0)
    reduced = _mask_hessian(qp.h * scale[:, None] * scale[None], free)
    d_x: Array = d_held + scale * solve_positive_definite(reduced, (scale * right)[:, None])[:, 0]
    return d_x


# --- scaling to a diagonal near one -------------------------------------------------------------------------------


def _jacobi_scale(h: Array) -> Array:
    """`s_i ≈ 1/√H_ii`, rounded to a power of two so that the scaling is exact."""
    diagonal = jnp.diagonal(h)
    sound = jnp.isfinite(diagonal) & (diagonal > 0)
    _, exponent = jnp.frexp(jnp.where(sound, diagonal, 1.0))
    return jnp.ldexp(jnp.ones_like(diagonal), -(exponent // 2))


def _fault(qp: BoxQp) -> Array:
    """Return the status of invalid data, or `ITERATION_LIMIT`, the status of a search in progress, for valid data."""
    finite = jnp.all(jnp.isfinite(qp.h)) & jnp.all(jnp.isfinite(qp.g))
    finite &= ~jnp.any(jnp.isnan(qp.lower) | jnp.isnan(qp.upper))
    feasible = jnp.all((qp.lower <= qp.upper) & (qp.lower < jnp.inf) & (qp.upper > -jnp.inf))
    status = jnp.where(jnp.all(jnp.diagonal(qp.h) > 0), ITERATION_LIMIT, NOT_POSITIVE_DEFINITE)
    status = jnp.where(feasible, status, INFEASIBLE_BOUNDS)
    return jnp.where(finite, status, NON_FINITE)


def _mask_hessian(h: Array, free: Array) -> Array:
    """Return H on the free rows and columns, and the identity elsewhere."""
    return jnp.where(free[:, None] & free[None], h, jnp.eye(h.shape[0], dtype=h.dtype))


# --- active set ---------------------------------------------------------------------------------------------------


class _Search(NamedTuple):
    y: Array
    side: Array
    status: Array
    iterations: Array


def _begin(qp: BoxQp, start: WarmStart, status: Array) -> _Search:
    """Project `start` into the bounds and free the variables held at an infinite bound."""
    side = jnp.where(qp.lower >= qp.upper, -1, start.side)
    at_lower, at_upper = (side < 0) & jnp.isfinite(qp.lower), (side > 0) & jnp.isfinite(qp.upper)
    inside = jnp.clip(jnp.where(jnp.isfinite(start.x), start.x, 0.0), qp.lower, qp.upper)
    y = jnp.where(at_lower, qp.lower, jnp.where(at_upper, qp.upper, inside))
    side = at_upper.astype(jnp.int8) - at_lower.astype(jnp.int8)
    return _Search(y, side, status.astype(jnp.int32), jnp.zeros((), jnp.int32))


def _is_unfinished(search: _Search) -> Array:
    return (search.status == ITERATION_LIMIT) & (search.iterations < PASSES_PER_VARIABLE * search.y.shape[-1])


def _search_one(qp: BoxQp, search: _Search) -> _Search:
    end: _Search = lax.while_loop(_is_unfinished, partial(_pass, qp), search)
    return end


def _search_batch(qp: BoxQp, search: _Search) -> _Search:
    """Search for a whole batch; on a CPU only those are searched for whose first working set is not the last."""

    def chunks(qp: BoxQp, search: _Search) -> _Search:
        tried = lax.map(lambda sample: _try(*sample), (qp, search), batch_size=CHUNK)
        pending = _is_unfinished(tried)
        ended: _Search = map_in_chunks(_search_one, (qp,), tried, jnp.argsort(~pending), jnp.sum(pending))
        return ended

    searched: _Search = lax.platform_dependent(qp, search, cpu=chunks, default=jax.vmap(_search_one))
    return searched


_active_set = with_batch_rule(_search_one, _search_batch)


class _Step(NamedTuple):
    """Newton step of the free variables."""

    gradient: Array
    """Of the objective, where the step begins."""
    step: Array
    meets: Array
    """Share of the step with which each variable meets a bound."""
    fits: Array
    """Whether the whole step stays within the bounds: its end is the minimiser of the working set."""
    whole: Array
    """The end of the step, refined once with the same factor."""
    released: Array
    """Which variables do not need their bounds there."""


def _take_step(qp: BoxQp, search: _Search) -> _Step:
    y, side = search.y, search.side
    free = side == 0
    factor = cholesky(_mask_hessian(qp.h, free))

    def newton(gradient: Array) -> Array:
        return jnp.where(free, -solve_factored(factor, jnp.where(free, gradient, 0.0)[:, None])[:, 0], 0.0)

    gradient = dot(qp.h, y) + qp.g
    step = newton(gradient)
    moves = step != 0
    meets = jnp.where(moves, (jnp.where(step > 0, qp.upper, qp.lower) - y) / jnp.where(moves, step, 1.0), jnp.inf)
    fits = jnp.min(meets) >= 1

    whole = jnp.clip(y + step, qp.lower, qp.upper)
    whole = jnp.clip(whole + newton(dot(qp.h, whole) + qp.g), qp.lower, qp.upper)
    slope = dot(qp.h, whole) + qp.g
    rounding = slope.shape[0] * np.finfo(slope.dtype).eps * jnp.maximum(_max_abs(qp.g), _max_abs(whole))
    released = ((side < 0) & (slope < -rounding) | (side > 0) & (slope > rounding)) & (qp.lower < qp.upper)
    return _Step(gradient, step, meets, fits, whole, released)


def _try(qp: BoxQp, search: _Search) -> _Search:
    """Return the end of a search that one pass ends, and otherwise the search itself."""
    taken = _take_step(qp, search)
    ends = _is_unfinished(search) & taken.fits & ~jnp.any(taken.released) & jnp.all(jnp.isfinite(taken.step))
    solved = jnp.full_like(search.status, SOLVED)
    return where(ends, _Search(taken.whole, search.side, solved, search.iterations + 1), search)


def _pass(qp: BoxQp, search: _Search) -> _Search:
    """One pass of the active set.

    Takes the Newton step of the free variables. If the whole step stays within the bounds, the point is the minimiser
    of its working set, and variables whose bounds are not needed are freed. Otherwise the step, projected onto the
    bounds, is followed to the breakpoint with the lowest objective, and the variables that have met their bounds are
    held. The objective decreases from one such minimiser to the next, so no working set recurs.
    """
    gradient, step, meets, fits, whole, released = _take_step(qp, search)

    def end() -> tuple[Array, Array]:
        return whole, jnp.where(released, 0, search.side).astype(jnp.int8)

    y, side = lax.cond(fits, end, lambda: _bend(qp, search, gradient, step, meets))
    finished = fits & ~jnp.any(released)
    status = jnp.where(finished, SOLVED, ITERATION_LIMIT)
    status = jnp.where(jnp.all(jnp.isfinite(step)), status, NOT_POSITIVE_DEFINITE)
    return _Search(y, side, status.astype(jnp.int32), search.iterations + 1)


def _bend(qp: BoxQp, search: _Search, gradient: Array, step: Array, meets: Array) -> tuple[Array, Array]:
    """Return point and working set at the breakpoint of the projected step with the lowest objective."""
    y, side = search.y, search.side
    # Breakpoints, one per variable, up to the whole step.
    t = jnp.minimum(meets, 1.0)
    offsets = jax.vmap(lambda share: jnp.clip(y + share * step, qp.lower, qp.upper) - y)(t)
    objective = dot(offsets, gradient) + 0.5 * jnp.sum(dot(offsets, qp.h) * offsets, axis=1)
    # A bound met at once (t = 0, degenerate) does not change the objective, but the variable is held from now on.
    corner = jnp.argmin(jnp.where(meets <= 1, objective, jnp.inf))
    t_corner = t[corner]
    met = (step != 0) & (meets <= t_corner)
    bent = jnp.where(met, jnp.where(step > 0, qp.upper, qp.lower), y + t_corner * step)
    bent_side = jnp.where(met, jnp.sign(step).astype(jnp.int8), side)
    return jnp.clip(bent, qp.lower, qp.upper), bent_side


def _max_abs(x: Array) -> Array:
    return jnp.max(jnp.abs(x))
