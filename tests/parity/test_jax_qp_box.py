"""The batched box QP against the Rust crate's solver: harvested along flights, saturated, without an answer."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.control import qp
from jax_aero.control.qp import BoxQp

pytestmark = pytest.mark.usefixtures("x64")

EVERY = 12
OF_RANGE = 1e-9
COUNT = 1024
UNIT_ROUNDOFF = np.finfo(np.float64).eps / 2


def harvest(name):
    """Momentum and torque QPs of every `EVERY`th tick of a flight."""
    config = rust.load_config(name)
    log = rust.fly(config).log
    controller = rust.Controller(config)
    momentum, torque = [], []
    for k, time in enumerate(log["time"]):
        velocity = np.concatenate([log["base_velocity"][k], log["joint_velocity"][k]])
        rotation = rust.rotation_from_wxyz(log["base_quaternion"][k])
        state = rust.State(log["base_position"][k], rotation, log["joint_position"][k], velocity)
        tick = controller.tick(state, log["thrust"][k], log["wind"][k], time)
        if k % EVERY == 0:
            momentum.append(tick.momentum_qp)
            torque.append(tick.torque_qp)
    return stack(momentum), stack(torque)


def stack(problems):
    return BoxQp(*(np.stack([np.asarray(getattr(one, name)) for one in problems]) for name in BoxQp._fields))


def take_exactly(problem, count, rng):
    """`count` of the problems: one batch size for the whole module, so one compilation for each number of variables."""
    rows = rng.permutation(np.resize(np.arange(len(problem.g)), count))
    return BoxQp(*(part[rows] for part in problem))


def solve_with_crate(problem):
    """Cold answers of the crate: x, status codes."""
    solver = rust.BoxQpSolver(problem.g.shape[1])
    answers = []
    for one in zip(*problem, strict=True):
        solver.reset()
        answers.append(solver.solve(*(np.ascontiguousarray(part) for part in one)))
    return np.stack([x for x, _ in answers]), np.array([answer["status_code"] for _, answer in answers])


@pytest.fixture(scope="module")
def harvested():
    flights = [harvest(name) for name in ("test1_published", "test2")]
    return [BoxQp(*(np.concatenate(parts) for parts in zip(*kind, strict=True))) for kind in zip(*flights, strict=True)]


@pytest.fixture(scope="module")
def solve():
    return jax.jit(jax.vmap(lambda problem, start: qp.solve(BoxQp(*problem), start)))


def cold_starts(problem):
    return jax.tree.map(lambda x: jnp.stack([x] * len(problem.g)), qp.cold_start(problem.g.shape[1], jnp.float64))


def evaluation_rounding(problem, x):
    """Bound of what rounding does to `kkt_residual`, per unit roundoff and problem.

    `H x + g` is a sum of n + 1 products, divided by √H_ii and by the residual's scale: n + 3 roundings of
    `max_i (|H| |x| + |g|)_i / √H_ii / scale` (Higham, Accuracy and Stability of Numerical Algorithms, section 3.1).
    """
    root = np.sqrt(np.diagonal(problem.h, axis1=1, axis2=2))
    terms = np.einsum("kij,kj->ki", np.abs(problem.h), np.abs(x)) + np.abs(problem.g)
    scale = np.maximum(1, np.maximum(np.abs(problem.g / root).max(axis=1), np.abs(root * x).max(axis=1)))
    return (x.shape[1] + 3) * (terms / root).max(axis=1) / scale


def assert_solves(answer, problem, measured, what):
    x, _ = solve_with_crate(problem)
    kkt = np.array([rust.kkt_residual(*one) for one in zip(*problem, np.asarray(answer.x), strict=True)])
    error = np.max(np.abs(answer.x - x) / (problem.upper - problem.lower))
    measured(f"{what}: most passes", float(answer.iterations.max()))
    assert np.all(answer.status == qp.SOLVED)
    assert np.all((answer.x >= problem.lower) & (answer.x <= problem.upper))
    measured(f"{what}: error of range", error, OF_RANGE)
    # A Cholesky solve of n = 27 unknowns leaves (3 n + 1) n u = 2.5e-13 of the scale (Higham, theorem 10.4, with
    # |Lᵀ| |L| ≤ √(H_ii H_jj)), and evaluating that takes part in it.
    rounding = UNIT_ROUNDOFF * evaluation_rounding(problem, np.asarray(answer.x))
    measured(f"{what}: optimality residual", np.max(kkt - rounding), 2.5e-13)
    # The residual reported is the crate's, up to the rounding of either.
    measured(f"{what}: residual reported, of its rounding", np.max(np.abs(answer.kkt - kkt) / (2 * rounding)), 1.0)


@pytest.mark.parametrize("which", [0, 1], ids=["momentum", "torque"])
def test_flight_problems_cold_and_warm(harvested, solve, measured, which):
    problem = take_exactly(harvested[which], COUNT, np.random.default_rng(1))
    answer = solve(problem, cold_starts(problem))
    assert_solves(answer, problem, measured, "cold")
    nudged = problem._replace(g=problem.g * (1 + 1e-6))
    again = solve(nudged, answer.warm_start)
    assert_solves(again, nudged, measured, "warm")
    assert np.mean(again.iterations == 1) > 0.95


@pytest.mark.parametrize("which", [0, 1], ids=["momentum", "torque"])
def test_saturated_problems(harvested, solve, measured, which):
    """A gradient 0.1 to 10 times as large as flight's, in any direction: most bounds are active."""
    rng = np.random.default_rng(2)
    problem = take_exactly(harvested[which], COUNT, rng)
    size = np.abs(problem.g).max(axis=1, keepdims=True) * rng.choice([0.1, 1.0, 10.0], size=(COUNT, 1))
    problem = problem._replace(g=problem.g + size * rng.normal(size=problem.g.shape))
    answer = solve(problem, cold_starts(problem))
    assert_solves(answer, problem, measured, "saturated")
    assert np.mean(answer.side != 0) > 0.2


def test_a_wrong_warm_start_costs_passes_and_nothing_else(harvested, solve, measured):
    rng = np.random.default_rng(3)
    problem = take_exactly(harvested[0], COUNT, rng)
    wrong = qp.WarmStart(
        jnp.asarray(rng.normal(scale=1e3, size=problem.g.shape)),
        jnp.asarray(rng.integers(-1, 2, size=problem.g.shape), jnp.int8),
    )
    assert_solves(solve(problem, wrong), problem, measured, "wrong start")


def test_odd_boxes_and_data_without_an_answer(harvested, solve):
    """Infinite, one-sided and closed boxes; faults have the crate's status code and leave the starting point."""
    rng = np.random.default_rng(4)
    flight = take_exactly(harvested[0], COUNT, rng)
    h, g, lower, upper = (np.array(part) for part in flight)
    n = g.shape[1]
    lower[0], upper[0] = -np.inf, np.inf
    upper[1] = np.inf
    lower[2] = upper[2]
    lower[3, ::2] = upper[3, ::2]
    h[4, 2, 3] = np.nan
    g[5, 0] = np.inf
    lower[6, 1] = np.nan
    lower[7], upper[7] = flight.upper[7], flight.lower[7]
    lower[8, 0] = upper[8, 0] = np.inf
    h[9] = -h[9]
    h[10] -= 20.0 * np.eye(n)
    problem = BoxQp(h, g, lower, upper)
    start = cold_starts(problem)._replace(x=jnp.full(g.shape, 1e-3))
    answer = solve(problem, start)
    x, codes = solve_with_crate(problem)
    np.testing.assert_array_equal(answer.status, codes)
    assert set(codes[4:11]) == {qp.NON_FINITE, qp.INFEASIBLE_BOUNDS, qp.NOT_POSITIVE_DEFINITE}
    well = codes == qp.SOLVED
    assert well[:4].all()
    assert well[11:].all()
    np.testing.assert_allclose(answer.x[well], x[well], rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(answer.x[4:9], start.x[4:9])
    assert np.all(np.isnan(answer.kkt[4:9]))


@pytest.mark.close_to_tolerance("an answer is accepted anywhere below the certificate's tolerance")
def test_float32_answers_are_certified_and_as_low_as_that_guarantees(harvested, measured):
    """Judged in float64 with the data that were not rounded: the residual r and the objective; x has no bound.

    Single precision rounds data and certificate; either adds at most `evaluation_rounding` to the tolerance κ. In
    the units y = √H_ii x let p = y − r be the projection that defines r, q the gradient and y* the minimiser. Then
    (p − y + q)·(y* − p) ≥ 0, and with convexity f(y) − f(y*) ≤ q·(y − y*) ≤ |r|∞ Σ_i (|q_i| + |p_i − y*_i|).
    The flight's condition number 2e8 exceeds 1/u = 1.7e7, so x may be off by much of its range along flat directions.
    """
    problem = take_exactly(harvested[0], COUNT, np.random.default_rng(5))
    best, _ = solve_with_crate(problem)
    with jax.enable_x64(False):
        answer = jax.jit(jax.vmap(qp.solve))(BoxQp(*(np.float32(part) for part in problem)))
        assert answer.x.dtype == jnp.float32
        answer = jax.device_get(answer)
    assert np.all(answer.status == qp.SOLVED)
    x = np.asarray(answer.x, np.float64)
    measured("float32: error of range", float(np.max(np.abs(x - best) / (problem.upper - problem.lower))))

    kkt = np.array([rust.kkt_residual(*one) for one in zip(*problem, x, strict=True)])
    certified = qp.kkt_tolerance(jnp.float32) + np.finfo(np.float32).eps * evaluation_rounding(problem, x)
    measured("float32: optimality residual, of what is certified", np.max(kkt / certified), 1.0)

    root = np.sqrt(np.diagonal(problem.h, axis1=1, axis2=2))
    gradient = (np.einsum("kij,kj->ki", problem.h, x) + problem.g) / root
    projection = np.clip(root * x - gradient, root * problem.lower, root * problem.upper)
    scale = np.maximum(1, np.maximum(np.abs(problem.g / root).max(axis=1), np.abs(root * x).max(axis=1)))
    guaranteed = certified * scale * (np.abs(gradient) + np.abs(projection - root * best)).sum(axis=1)
    step = x - best
    # f(x) − f(x*) without the cancellation of two objectives: q(x)·d − ½ d·H d.
    above = np.sum(root * gradient * step, axis=1) - np.einsum("ki,kij,kj->k", step, problem.h, step) / 2
    measured("float32: objective above the minimum, of what that guarantees", np.max(above / guaranteed), 1.0)


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_the_residual_away_from_the_minimum_is_the_crates(size):
    """Of data less and more than one, which divides it."""
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(5, 5))
    problem = BoxQp(factor @ factor.T + np.eye(5), size * rng.normal(size=5), np.full(5, -size), np.full(5, 2.0 * size))
    x = size * rng.uniform(-1.0, 2.0, 5)
    expected = rust.kkt_residual(*problem, x)
    assert expected > 0.001
    np.testing.assert_allclose(qp.kkt_residual(problem, jnp.asarray(x)), expected, rtol=1e-12)
