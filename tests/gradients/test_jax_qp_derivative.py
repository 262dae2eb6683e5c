"""The derivative of the box QP: both modes, finite differences of the Rust crate's answers, and the corners."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.control import qp
from jax_aero.control.qp import BoxQp
from jax_aero.rust import BoxQpSolver

pytestmark = pytest.mark.usefixtures("x64")

N, CASES = 27, 24


def problems(rng, count):
    """Flight-like: nine stiff rows, small weights, very different units; from calm to saturated."""
    units = np.where(np.arange(N) < 4, 100.0, 0.8)
    tasks = rng.normal(size=(count, 9, N)) * np.where(np.arange(N) < 4, 1.0, 30.0)
    h = 10.0 * np.einsum("bki,bkj->bij", tasks, tasks) + np.diag(np.where(np.arange(N) < 4, 0.01, 13.75))
    push = np.logspace(-3, 1, count)[:, None] * np.sqrt(np.einsum("bii->bi", h))
    lower, upper = -units * rng.uniform(0.2, 1, (count, N)), units * rng.uniform(0.2, 1, (count, N))
    return BoxQp(h, push * rng.normal(size=(count, N)), lower, upper)


def directions(rng, problem):
    """Symmetric for H; everything relative to its own size."""
    root = np.sqrt(np.einsum("bii->bi", problem.h))
    symmetric = rng.normal(size=problem.h.shape)
    width = problem.upper - problem.lower
    return BoxQp(
        1e-2 * (symmetric + np.swapaxes(symmetric, 1, 2)) * root[:, :, None] * root[:, None, :],
        rng.normal(size=problem.g.shape) * np.abs(problem.g),
        rng.normal(size=width.shape) * width,
        rng.normal(size=width.shape) * width,
    )


def answers_of_the_crate(problem):
    found = []
    for one in zip(*problem, strict=True):
        x, answer = BoxQpSolver(N).solve(*(np.ascontiguousarray(part) for part in one))
        assert answer["status"] == "Solved"
        found.append(x)
    return np.stack(found)


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(11)
    problem = problems(rng, CASES)
    return problem, directions(rng, problem), rng.normal(size=(CASES, N)) / (problem.upper - problem.lower)


def minimiser(problem):
    return qp.solve(BoxQp(*problem)).x


@pytest.fixture(scope="module")
def pull_back():
    """Batched product with a vector from the left, and the answer itself."""

    @jax.jit
    @jax.vmap
    def solve_and_pull(problem, cotangent):
        x, transposed = jax.vjp(minimiser, BoxQp(*problem))
        return x, transposed(cotangent)[0]

    return solve_and_pull


@pytest.fixture(scope="module")
def push_forward():
    return jax.jit(jax.vmap(lambda problem, tangent: jax.jvp(minimiser, (BoxQp(*problem),), (BoxQp(*tangent),))[1]))


@pytest.mark.close_to_tolerance("error of the quotient: answers of 1e-13 accuracy over a step of 1e-7")
def test_reverse_is_forward_is_the_finite_difference(case, pull_back, push_forward):
    problem, tangent, cotangent = case
    x, gradient = pull_back(problem, cotangent)
    held = np.sum((x == problem.lower) | (x == problem.upper), axis=1)
    assert held.min() <= 2
    assert held.max() >= 18
    forward = np.einsum("bi,bi->b", cotangent, push_forward(problem, tangent))
    reverse = sum(np.sum(a * b, axis=tuple(range(1, a.ndim))) for a, b in zip(gradient, tangent, strict=True))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)

    def solve_moved(step):
        return answers_of_the_crate(BoxQp(*(a + step * b for a, b in zip(problem, tangent, strict=True))))

    step = 1e-7
    difference = np.einsum("bi,bi->b", cotangent, (solve_moved(step) - solve_moved(-step)) / (2 * step))
    np.testing.assert_allclose(forward, difference, rtol=1e-5, atol=1e-6)


def small_problem(lower, upper, g=(1.0, -2.0)):
    h = jnp.array([[2.0, 0.5], [0.5, 1.0]])
    return BoxQp(h, jnp.asarray(g), jnp.asarray(lower), jnp.asarray(upper))


@pytest.fixture(scope="module")
def jacobian():
    """Derivative of x in g and in the bounds of a problem with two variables."""
    return jax.jit(jax.jacrev(lambda problem: qp.solve(problem).x))


def test_a_fixed_variable_moves_with_the_bound_that_its_gradient_presses_it_against(jacobian):
    found = jacobian(small_problem((0.3, 0.2), (0.3, 5.0)))  # the first gradient component is positive: pressed down
    np.testing.assert_allclose(found.lower[0], [1.0, 0.0])
    np.testing.assert_allclose(found.upper[0], [0.0, 0.0])
    np.testing.assert_allclose(found.lower[1], [-0.5, 0.0])
    found = jacobian(small_problem((0.3, 0.2), (0.3, 5.0), g=(-9.0, -2.0)))
    np.testing.assert_allclose(found.lower[0], [0.0, 0.0])
    np.testing.assert_allclose(found.upper[0], [1.0, 0.0])


def test_a_variable_that_touches_its_bound_without_pressing_counts_as_held(jacobian):
    """x = (0, 0) with both gradients zero: of the two one-sided derivatives, the one where the bound acts."""
    found = jacobian(small_problem((0.0, -1.0), (1.0, 1.0), g=(0.0, 0.0)))
    np.testing.assert_allclose(found.g, [[0.0, 0.0], [0.0, -1.0]])


@pytest.mark.parametrize(
    ("lower", "upper", "g"),
    [((1.0, 1.0), (0.0, 0.0), (1.0, 1.0)), ((-1.0, -1.0), (1.0, 1.0), (jnp.nan, 1.0))],
    ids=["infeasible", "not finite"],
)
def test_without_an_answer_the_derivative_is_zero(jacobian, lower, upper, g):
    found = jacobian(small_problem(lower, upper, g))
    for part in found:
        np.testing.assert_array_equal(part, np.zeros_like(part))


def test_batches_within_batches():
    """x(g) is linear without bounds."""
    scales = jnp.array([[1.0, 2.0, 3.0], [0.5, 4.0, 6.0]])
    free = small_problem((-jnp.inf, -jnp.inf), (jnp.inf, jnp.inf))
    many = jax.jit(jax.vmap(jax.vmap(lambda s: qp.solve(free._replace(g=s * free.g)).x)))(scales)
    np.testing.assert_allclose(many, scales[..., None] * many[0, 0], rtol=1e-14)


def test_second_derivative():
    """x(s) = −(s H)⁻¹ g without bounds, so d²x/ds² = 2 x at s = 1."""
    free = small_problem((-jnp.inf, -jnp.inf), (jnp.inf, jnp.inf))

    def x(s):
        return qp.solve(free._replace(h=s * free.h)).x

    curvature = jax.jit(jax.jacfwd(jax.jacfwd(x)))(1.0)
    np.testing.assert_allclose(curvature, 2.0 * np.linalg.solve(free.h, -free.g), rtol=1e-12)


def test_an_answer_that_was_found_before_has_the_same_derivative(case):
    """Both modes; without derivatives it is the answer as it is."""
    problem, towards, cotangent = case

    @jax.jit
    @jax.vmap
    def evaluate(problem, towards, cotangent):
        answer = jax.lax.stop_gradient(qp.solve(BoxQp(*problem)))
        found = []
        for function in (minimiser, lambda problem: qp.minimiser(BoxQp(*problem), answer)):
            x, forward = jax.jvp(function, (problem,), (towards,))
            found.append((x, forward, jax.vjp(function, problem)[1](cotangent)[0]))
        return found

    solved, given = evaluate(problem, towards, cotangent)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12 * np.abs(a).max()), solved, given)
    assert np.any(np.asarray(given[1]) != 0.0)
