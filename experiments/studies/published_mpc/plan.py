"""The quadratic program of the published controller, over 17 knots, and its solution by Clarabel.

    minimise   Σ ½ |x − x_d|²_Q + ½ w_s |Δs|² + ½ w_r |s + Δs − s_0|² + ½ w_v (|v_0 − v_now|² + Σ |v_i+1 − v_i|²)
    subject to x_0 measured, the model between knots, 0 % ≤ throttles ≤ 100 %

588 variables: 18 states, 12 increments of the joints, 6 throttles. The first throttle acts for 0.1 s; it may change
when it is due, and is held by the problem in between. After the control horizon the last inputs remain.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from experiments.studies.published_mpc.model import (
    ANGULAR,
    ATTITUDE,
    ATTITUDE_INTEGRAL,
    CONSTANT,
    DRIVES,
    JETS,
    JOINTS,
    LINEAR,
    POSITION,
    POSITION_INTEGRAL,
    STATES,
    THRUST,
    THRUST_RATE,
    Array,
    Model,
    drive,
)

FAST, SLOW, CONTROL = 7, 10, 12
KNOTS = FAST + SLOW
PERIOD, LARGE = 0.005, 0.1
"""Period of the controller, and of a large knot and of the throttles [s]."""
ARMS = 8
JOINTS_AT = STATES * (KNOTS + 1)
DRIVES_AT = JOINTS_AT + ARMS * CONTROL
VARIABLES = DRIVES_AT + JETS * (CONTROL - FAST + 1)
EQUATIONS = JOINTS_AT
"""Rows of the model and of the initial state."""

WEIGHTS = np.zeros(STATES)
WEIGHTS[POSITION], WEIGHTS[POSITION_INTEGRAL] = (500.0, 500.0, 5000.0), (25000.0, 25000.0, 50000.0)
WEIGHTS[LINEAR], WEIGHTS[ANGULAR] = (1.0, 1.0, 1.5), 80.0
WEIGHTS[ATTITUDE], WEIGHTS[ATTITUDE_INTEGRAL] = 1000.0, 10000.0
INCREMENT, POSTURE, DRIVE = 65000.0, 20.0, 80000.0
"""Weights of joint increments, of joint positions, and of changes of v."""


def knots(*, warped: bool = True) -> Array:
    """Return the lengths of the knots [s].

    The first seven are of 5 ms, or, as in the public code, start with 5 ms and grow linearly to 0.1 s in all.
    """
    small = np.full(FAST, PERIOD)
    if warped:
        small += (2.0 * np.arange(FAST)) * (LARGE - FAST * PERIOD) / (FAST * (FAST - 1))
    return np.concatenate([small, np.full(SLOW, LARGE)])


class Problem(NamedTuple):
    """Minimise ½ zᵀ P z + qᵀ z; the first rows of A z = b are equations, the others A z ≤ b."""

    p: Any
    """Upper triangle, sparse, (588, 588)."""
    q: Array
    a: Any
    """Sparse, (rows, 588)."""
    b: Array
    equations: int
    """Number of equations."""


class Planner:
    """Builds and solves the problems of one robot; their pattern is built once."""

    def __init__(self, lengths: Array) -> None:
        self.lengths = lengths
        at = np.arange(KNOTS)
        joint, v = np.minimum(at, CONTROL - 1), np.clip(at - FAST + 1, 0, CONTROL - FAST)
        columns = np.concatenate(
            [
                STATES * at[:, None] + np.arange(STATES),
                JOINTS_AT + ARMS * joint[:, None] + np.arange(ARMS),
                DRIVES_AT + JETS * v[:, None] + np.arange(JETS),
            ],
            axis=1,
        )
        self.pattern = _pattern()
        row, column = np.nonzero(self.pattern)
        rows = STATES * (1 + at[:, None]) + row
        ones = np.arange(EQUATIONS)
        first, last = DRIVES_AT + np.arange(JETS), np.arange(DRIVES_AT, VARIABLES)
        entries = [(ones, ones), (rows.ravel(), columns[:, column].ravel())]
        self.solvers = {}
        for is_held in (False, True):
            free = last[JETS:] if is_held else last
            fixed = first if is_held else first[:0]
            n = EQUATIONS + len(fixed)
            more = [
                (np.arange(EQUATIONS, n), fixed),
                (np.arange(n, n + len(free)), free),
                (np.arange(n + len(free), n + 2 * len(free)), free),
            ]
            self.solvers[is_held] = _Solver(entries + more, n, len(free))
        self.p = _hessian()

    def problem(self, model: Model, state: Array, v: Array, off: Array, targets: Array, *, is_held: bool) -> Problem:
        """Return the problem of a tick.

        Parameters
        ----------
        model
            The model about the present state.
        state
            Present state (26,).
        v
            Present v of the throttles, (4,).
        off
            Joint references of the arms less those of the start [rad], (8,).
        targets
            States to follow at the ends of the knots, (18, 26), with the present one first; their integrals are zero.
        is_held
            Whether throttles are not due.
        """
        step = model.at_once[None] + self.lengths[:, None, None] * model.per_second[None]
        q = np.zeros(VARIABLES)
        q[STATES:JOINTS_AT] = -(WEIGHTS * targets[1:]).ravel()
        q[JOINTS_AT:DRIVES_AT] = np.tile(POSTURE * off, CONTROL)
        q[DRIVES_AT : DRIVES_AT + JETS] = -DRIVE * v
        constant = step[:, :, CONSTANT].copy()
        for integral, tracked in ((POSITION_INTEGRAL, POSITION), (ATTITUDE_INTEGRAL, ATTITUDE)):
            constant[:, integral] -= self.lengths[:, None] * targets[:-1, tracked]
        solver = self.solvers[is_held]
        low, high = drive(np.array([0.0, 100.0]))
        b = [
            state,
            -constant.ravel(),
            v if is_held else v[:0],
            np.full(solver.bounds, high),
            np.full(solver.bounds, -low),
        ]
        values = np.concatenate(
            [solver.signs_before, step[:, :, :CONSTANT][:, self.pattern].ravel(), solver.signs_after]
        )
        return Problem(self.p, q, solver.matrix(values), np.concatenate(b), solver.equations)

    def solve(self, problem: Problem) -> Array | None:
        """Return the variables (588,), or `None` without a solution."""
        return self.solvers[problem.equations > EQUATIONS].solve(problem)


class _Solver:
    """Clarabel on problems of one pattern."""

    def __init__(self, entries: list[tuple[Any, Any]], equations: int, bounds: int) -> None:
        rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
        self.equations, self.bounds = equations, bounds
        shape = (equations + 2 * bounds, VARIABLES)
        numbered = sparse.csc_matrix((np.arange(1, len(rows) + 1, dtype=float), (rows, columns)), shape)
        self.order = numbered.data.astype(int) - 1
        self.shape = (numbered.indices, numbered.indptr, shape)
        # x_k+1 has −1 in its rows, x_0 has 1.
        self.signs_before = np.concatenate([np.ones(STATES), -np.ones(EQUATIONS - STATES)])
        self.signs_after = np.concatenate([np.ones(equations - EQUATIONS + bounds), -np.ones(bounds)])
        self.clarabel: Any = importlib.import_module("clarabel")
        self.settings = self.clarabel.DefaultSettings()
        self.settings.verbose = self.settings.presolve_enable = False
        self.settings.equilibrate_enable = self.settings.iterative_refinement_enable = False  # four times as fast
        self.settings.tol_gap_abs = self.settings.tol_gap_rel = self.settings.tol_feas = 1e-6
        self.settings.max_threads, self.settings.direct_solve_method = 1, "qdldl"
        self.solver: Any = None

    def matrix(self, values: Array) -> Any:
        indices, indptr, shape = self.shape
        return sparse.csc_matrix((values[self.order], indices, indptr), shape)

    def solve(self, problem: Problem) -> Array | None:
        if self.solver is None:
            cones = [self.clarabel.ZeroConeT(self.equations), self.clarabel.NonnegativeConeT(2 * self.bounds)]
            p, q, a, b, _ = problem
            self.solver = self.clarabel.DefaultSolver(p, q, a, b, cones, self.settings)
        else:
            self.solver.update(q=problem.q, A=problem.a.data, b=problem.b)
        answer = self.solver.solve()
        is_solved = str(answer.status) in ("Solved", "AlmostSolved")
        return np.asarray(answer.x) if is_solved else None


def _pattern() -> Any:
    """Return where the model's matrices may be other than zero, without the column of constants, (26, 38)."""
    pattern = np.zeros((STATES, CONSTANT), dtype=bool)
    pattern[:, :STATES] = np.eye(STATES, dtype=bool)
    for row, columns in (
        (POSITION, (LINEAR,)),
        (LINEAR, (LINEAR, THRUST, JOINTS)),
        (ATTITUDE, (ANGULAR,)),
        (ANGULAR, (ANGULAR, THRUST, JOINTS)),
    ):
        for column in columns:
            pattern[row, column] = True
    diagonal = [(THRUST, THRUST_RATE), (THRUST, DRIVES), (THRUST_RATE, THRUST), (THRUST_RATE, DRIVES)]
    for row, column in [*diagonal, (POSITION_INTEGRAL, POSITION), (ATTITUDE_INTEGRAL, ATTITUDE)]:
        np.fill_diagonal(pattern[row, column], val=True)
    return pattern


def _hessian() -> Any:
    """Return the upper triangle of P."""
    diagonal = np.zeros(VARIABLES)
    diagonal[STATES:JOINTS_AT] = np.tile(WEIGHTS, KNOTS)
    diagonal[JOINTS_AT:DRIVES_AT] = INCREMENT + POSTURE
    diagonal[DRIVES_AT:] = 2.0 * DRIVE
    diagonal[-JETS:] = DRIVE
    beside = np.zeros(VARIABLES - JETS)
    beside[DRIVES_AT:] = -DRIVE
    return sparse.csc_matrix(sparse.diags([diagonal, beside], [0, JETS]))
