"""10,000 box QPs against the optimality conditions and DAQP (exact).

6,000 are harvested from ticks: along TEST1 and TEST2 as flown (warm started, as in flight) and at states thrown far
from them. 4,000 are adversarial, and the solver that meets them is warm from the one before.

DAQP gets every problem in units that are powers of two near 1/√H_ii. Nothing is rounded, so it is the same
problem; in raw units its tolerances, which are absolute, reject or miss some of the badly scaled ones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import daqp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.rust import BoxQpSolver, Controller, QpProblem, State

HARVESTED, ADVERSARIAL, EVERY = 6000, 4000, 5
KKT_TOLERANCE, X_TOLERANCE = 1e-9, 1e-8


class Case(NamedTuple):
    kind: str
    problem: QpProblem
    x: np.ndarray
    solved: bool


# --- harvested ---------------------------------------------------------------------------------------------------


def cases_of(tick: rust.Tick, kind: str) -> Iterator[Case]:
    u = np.concatenate([tick.thrust_rate, tick.joint_velocity_command])
    yield Case(f"momentum, {kind}", tick.momentum_qp, u, tick.momentum_answer.status == "Solved")
    yield Case(f"torque, {kind}", tick.torque_qp, tick.unlimited_torque, tick.torque_answer.status == "Solved")


def harvest(name: str, thrown: int, rng: np.random.Generator) -> Iterator[Case]:
    """Every fifth tick of a flight, and `thrown` ticks at states that it never came near."""
    config = rust.load_config(name)
    flight = rust.fly(config)
    flown, elsewhere = Controller(config), Controller(config)
    log = [flight[key] for key in ("base_position", "base_quaternion", "joint_position", "base_velocity")]
    chosen = set(rng.choice(len(flight["time"]), thrown, replace=False))
    limits = np.array(rust.Robot(config["robot"]).joint_limits)
    for k, time in enumerate(flight["time"]):
        position, quaternion, joints, twist = (signal[k] for signal in log)
        state = State(
            position,
            rust.rotation_from_wxyz(quaternion),
            joints,
            np.concatenate([twist, flight["joint_velocity"][k]]),
        )
        tick = flown.tick(state, flight["thrust"][k], flight["wind"][k], time)
        # The logged flight and this replay are one: else these would be problems of no flight.
        np.testing.assert_allclose(tick.thrust_rate, flight["thrust_rate"][k], rtol=1e-6, atol=1e-6)
        if k % EVERY == 0:
            yield from cases_of(tick, name)
        if k in chosen:
            turn = rng.normal(size=4) * [0, 1, 1, 1] * rng.choice([0.05, 0.5]) + [1, 0, 0, 0]
            far = State(
                position + rng.normal(scale=0.2, size=3),
                np.asarray(state.base_rotation) @ rust.rotation_from_wxyz(turn / np.linalg.norm(turn)),
                np.where(rng.random(23) < 0.3, rng.choice(limits.T), joints) + rng.normal(scale=0.05, size=23),
                np.asarray(state.velocity) + rng.normal(scale=0.5, size=29),
            )
            thrust = rng.choice([0.0, 0.5, 80.0, 159.9, 160.0], size=4)
            integral = rng.normal(scale=rng.choice([0.3, 3, 10]), size=23)
            wind = rng.normal(scale=10, size=3)
            started = elsewhere.start(far, thrust, wind)
            elsewhere.state = started.with_posture_control(tick.posture, tick.inertia_0_b, integral)
            yield from cases_of(elsewhere.tick(far, thrust, wind, setpoint=tick.setpoint), "thrown")


# --- adversarial -------------------------------------------------------------------------------------------------


def log_uniform(rng: np.random.Generator, low: float, high: float, size: int) -> np.ndarray:
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def flight_like_problem(rng: np.random.Generator, push: float) -> QpProblem:
    """Shaped like the momentum QP; the unbounded minimum lies `push` bound ranges away."""
    jet = np.arange(27) < 4
    momentum = rng.normal(size=(6, 27)) * np.where(jet, 1, log_uniform(rng, 100, 1000, 27))
    angular = rng.normal(size=(3, 27)) * np.where(jet, 0, log_uniform(rng, 0.01, 2, 27))
    h = 10 * momentum.T @ momentum + 150 * angular.T @ angular + np.diag(np.where(jet, 0.0101, 13.7501))
    wanted = push * rng.normal(size=27) * np.where(jet, 20, 0.2)
    g = -10 * momentum.T @ (momentum @ wanted) + np.where(jet, 0, 2 * push * rng.normal(size=27))
    lower, upper = (
        np.where(jet, 100 * np.tanh(rng.uniform(0.2, 2, 27)), np.radians(45) * np.tanh(rng.uniform(0, 2.5, 27)))
        for _ in range(2)
    )
    return QpProblem((h + h.T) / 2, g, -lower, upper)


def saturated_problem(rng: np.random.Generator) -> QpProblem:
    return flight_like_problem(rng, rng.choice([3.0, 6.0, 20.0]))


def ill_conditioned_problem(rng: np.random.Generator) -> QpProblem:
    """Eigenvalues over up to ten decades, units over six."""
    n, condition = int(rng.integers(2, 40)), rng.choice([1e4, 1e6, 1e8, 1e10])
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    eigenvalues = log_uniform(rng, 1 / condition, 1, n)
    eigenvalues[0], eigenvalues[-1] = 1 / condition, 1
    units = log_uniform(rng, 1e-3, 1e3, n)
    root = q / units[:, None]
    h = (root * eigenvalues) @ root.T
    h = (h + h.T) / 2
    g = -h @ (rng.choice([0.1, 1, 5]) * units * rng.normal(size=n))
    return QpProblem(h, g, -units * rng.uniform(0, 1, n), units * rng.uniform(0, 1, n))


def degenerate_bounds(rng: np.random.Generator) -> QpProblem:
    """One-sided, missing, nearly touching, and some through the point where a cold solver starts."""
    h, g, lower, upper = flight_like_problem(rng, 1.0)
    kind = rng.integers(0, 8, 27)
    lower[kind == 0], upper[kind == 1] = 0, 0
    lower[(kind == 2) | (kind == 4)], upper[(kind == 3) | (kind == 4)] = -np.inf, np.inf
    thin = kind == 5
    upper[thin] = lower[thin] + 1e-9 * (upper[thin] - lower[thin])
    return QpProblem(h, g, lower, upper)


def weakly_active_problem(rng: np.random.Generator) -> QpProblem:
    """The unconstrained minimiser lies in the box, on about half of its faces: every multiplier is zero."""
    h, _, lower, upper = flight_like_problem(rng, 1.0)
    kind = rng.integers(0, 4, 27)
    x = np.where(kind == 0, lower, np.where(kind == 1, upper, rng.uniform(lower, upper)))
    return QpProblem(h, -h @ x, lower, upper)


def fixed_problem(rng: np.random.Generator) -> QpProblem:
    """lb = ub for some variables, up to all of them."""
    h, g, lower, upper = (flight_like_problem(rng, 3.0), ill_conditioned_problem(rng))[rng.integers(2)]
    held = rng.random(len(g)) < rng.random()
    lower[held] = upper[held] = rng.uniform(lower, upper)[held]
    return QpProblem(h, g, lower, upper)


ADVERSARIES: tuple[Callable[[np.random.Generator], QpProblem], ...] = (
    saturated_problem,
    ill_conditioned_problem,
    degenerate_bounds,
    weakly_active_problem,
    fixed_problem,
)


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    rng = np.random.default_rng(20260102)
    found = [case for name in ("test1_published", "test2_published") for case in harvest(name, 800, rng)]
    assert len(found) >= HARVESTED
    found = [found[i] for i in np.sort(rng.permutation(len(found))[:HARVESTED])]
    solvers: dict[int, BoxQpSolver] = {}
    for index in range(ADVERSARIAL):
        adversary = ADVERSARIES[index % len(ADVERSARIES)]
        problem = adversary(rng)
        n = len(problem.g)
        x, answer = solvers.setdefault(n, BoxQpSolver(n)).solve(*problem)
        found.append(Case(adversary.__name__, problem, x, answer["status"] == "Solved"))
    return found


# --- the conditions and the oracle ---------------------------------------------------------------------------------


def kkt(problem: QpProblem, x: np.ndarray) -> float:
    """Largest violation of bounds, sign or complementarity in the units y = √H_ii x, over max(1, |g|, |y|).

    With multipliers λ = max(q, 0) of the lower and μ = max(−q, 0) of the upper bounds the gradient q = λ − μ
    vanishes by construction; each must meet either a zero or its bound.
    """
    root = np.sqrt(np.diag(problem.h))
    y, q = root * x, (problem.h @ x + problem.g) / root
    below, above = y - root * problem.lower, root * problem.upper - y
    violated = np.maximum(-below, -above)
    complementarity = np.maximum(np.minimum(np.maximum(q, 0), below), np.minimum(np.maximum(-q, 0), above))
    scale = max(1.0, np.abs(problem.g / root).max(), np.abs(y).max())
    return float(np.maximum(violated, complementarity).max() / scale)


def scale_to_even_units(problem: QpProblem) -> tuple[QpProblem, np.ndarray]:
    unit = np.exp2(np.round(-0.5 * np.log2(np.diag(problem.h))))
    h, g, lower, upper = problem
    return QpProblem(h * np.outer(unit, unit), g * unit, lower / unit, upper / unit), unit


def ask_daqp(problem: QpProblem) -> np.ndarray:
    n = len(problem.g)
    sense = np.where(problem.lower == problem.upper, 5, 0).astype(np.int32)
    settings = {"primal_tol": 1e-13, "dual_tol": 1e-14, "zero_tol": 1e-15, "sing_tol": 1e-18, "eps_prox": 0}
    h, g, lower, upper = problem
    return np.array(daqp.solve(h, g, np.zeros((0, n)), upper, lower, sense, **settings)[0])


# --- the claims ----------------------------------------------------------------------------------------------------


def test_there_are_ten_thousand_of_every_kind(cases, measured):
    counts = Counter(case.kind for case in cases)
    active = Counter()
    for case in cases:
        active[case.kind] += int(np.sum((case.x <= case.problem.lower) | (case.x >= case.problem.upper)))
    assert sum(counts.values()) == HARVESTED + ADVERSARIAL
    assert min(counts.values()) > 400
    assert active["momentum, thrown"] > 5 * counts["momentum, thrown"]
    assert active["torque, thrown"] > counts["torque, thrown"]
    for kind, count in counts.items():
        measured(f"problems: {kind}", f"{count}, {active[kind] / count:.1f} bounds active on average")


def test_every_answer_satisfies_the_optimality_conditions(cases, measured):
    for case in cases:
        assert case.solved, case
        assert np.all((case.x >= case.problem.lower) & (case.x <= case.problem.upper))
        measured(f"KKT residual, {case.kind}", kkt(case.problem, case.x), KKT_TOLERANCE)
        measured("KKT residual, the crate's", rust.kkt_residual(*case.problem, case.x), KKT_TOLERANCE)


@pytest.mark.close_to_tolerance("the bound is first order in eps cond(H): ill-conditioned problems come near it")
def test_x_is_that_of_daqp(cases, measured):
    """To 1e-8 of the bound range, or to what the condition of H leaves of sixteen digits of the largest unknown."""
    beyond, raw_misses = 0, Counter()
    for case in cases:
        even, unit = scale_to_even_units(case.problem)
        y, theirs = case.x / unit, ask_daqp(even)
        assert kkt(even, theirs) <= KKT_TOLERANCE, f"DAQP is not exact here: {case}"
        raw_misses[case.kind] += kkt(case.problem, ask_daqp(case.problem)) > KKT_TOLERANCE

        spread = even.upper - even.lower
        bounded = np.isfinite(spread) & (spread > 0)
        spread = np.where(bounded, spread, np.maximum(1, np.abs(theirs)))
        eigenvalues = np.linalg.eigvalsh(even.h)
        rounding = np.finfo(float).eps * eigenvalues[-1] / eigenvalues[0] * np.abs(theirs).max()
        difference = np.abs(y - theirs)
        measured(f"x − DAQP over bound range, {case.kind}", float((difference / spread).max()))
        allowed = np.maximum(X_TOLERANCE * spread, rounding)
        measured(f"x − DAQP, of what rounding allows, {case.kind}", (difference / allowed).max(), 1.0)
        beyond += bool(np.any(difference > X_TOLERANCE * spread))
    measured("x − DAQP beyond 1e-8, within eps cond(H) |x|", f"{beyond} of {len(cases)}")
    missed = ", ".join(f"{kind} {count}" for kind, count in raw_misses.items() if count)
    measured("DAQP in raw units not exact (KKT above 1e-9)", missed or "none")
