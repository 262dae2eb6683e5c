"""Trim: attitude, joint positions and thrusts for hovering or flying straight in a steady wind."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from jax_aero.symbolic import clearance
from jax_aero.symbolic.momentum import MomentumModel
from jax_aero.symbolic.robot import Array
from jax_aero.symbolic.spatial import SX, turn_from_rpy

Objective = Literal["min_thrust", "max_margin"]

IPOPT: dict[str, Any] = {
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-10,
    "ipopt.acceptable_iter": 0,
    "ipopt.perturb_always_cd": "yes",  # some equations are redundant, e.g. the moment about the axis of parallel jets
    "ipopt.max_iter": 400,
    "print_time": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
    "inputs_check": False,  # it prints a warning for a problem with more equations than unknowns
}
"""Options of the solver: silent, to full precision, without exceptions, since `Trim.solve` checks the answer."""

TOLERANCE = 1e-5
"""Tolerance of a scaled constraint and, relative to its range, of an unknown at a limit."""


@dataclass(frozen=True)
class TrimSettings:
    """Degrees of freedom and limits of a trim; SI units and radians. `configs/trim` gives the sources."""

    posture: Array
    """(n,) initial joint positions, near which the trim is kept with a small weight [rad]."""
    free_joints: tuple[int, ...]
    """Joints that may deviate from the posture."""
    roll: tuple[float, float]
    pitch: tuple[float, float]
    yaw: float
    """Attitude of the base: limits of roll and pitch, and the fixed yaw [rad]."""
    margin_min: float
    """Least distance of every thrust from both its limits, as a fraction of its greatest value."""
    torque_max: Array
    """(n,) greatest joint torques [N m]."""
    clearance_min: float
    """Least distance from the axis of a jet to the surface of a link [m]."""
    plume_length: float
    """Length of a jet's axis for which this is required [m]."""
    posture_weight: float
    """Weight of the mean squared deviation from the posture [1/rad²], relative to thrust over weight or margin."""
    spread_weight: float
    """Weight of Σ (T/T_max)², which makes the solution unique if several have the same total thrust."""


class Violation(NamedTuple):
    """A constraint that cannot be met, and its violation at the least total violation of all constraints."""

    constraint: str
    missed_by: float
    unit: str

    def __str__(self) -> str:
        """Return the violation in words."""
        return f"{self.constraint} missed by {self.missed_by:.3g} {self.unit}"


@dataclass(frozen=True)
class TrimResult:
    """An equilibrium, or the state nearest to one with the constraints that prevent it."""

    feasible: bool
    message: str
    """Message of the solver, or the violated constraints."""
    violations: tuple[Violation, ...]
    at_limit: tuple[str, ...]
    """Thrusts, joints and angles that are at a limit."""
    cost: float
    """Value of the objective, or without a trim the total violation of constraints."""
    base_rpy: Array
    joint_position: Array
    thrust: Array
    joint_torque: Array
    margin: float
    """Least distance of a thrust from a limit, as a fraction of its greatest value; half without a jet."""
    residual: Array
    """(6,) remaining momentum rate [N, N m]."""
    aero_force: Array
    """(3,) total force [N]."""
    aero_moment: Array
    """(3,) total moment about the centre of mass [N m]."""
    clearance: float
    """Least distance from the axis of a jet to the surface of a link [m]; infinite without a link."""
    closest: str
    """Jet and link with the least distance; empty without a link."""
    iterations: int
    solve_time: float
    """Time to solve [s]."""

    @property
    def total_thrust(self) -> float:
        """Sum of the thrusts [N]."""
        return float(self.thrust.sum())


class _Row(NamedTuple):
    """One constraint: its name, its unit, and its scale in that unit."""

    name: str
    unit: str
    scale: float
    value: SX
    lower: float
    upper: float


class Trim:
    """The trim problem of one robot with one aerodynamic model, built once and solved for many winds.

    Unknowns: roll, pitch, yaw of the base, joint positions s, thrusts T and the margin μ.

        minimise    w_T Σ T/(m g) − w_μ μ + w_s |s − s₀|²/n + w_e Σ (T/T_max)²
        subject to  L̇ = 0                                     six rows: no net force, no net moment
                    |τ| ≤ τ_max,  τ = ∂V/∂s − Σ J_sᵀ f        joints at rest
                    μ T_max ≤ T ≤ (1 − μ) T_max
                    distance(jet axis, link) ≥ d_min
                    limits of attitude, joints and thrusts
    """

    def __init__(self, model: MomentumModel, settings: TrimSettings) -> None:
        started = time.perf_counter()
        self.model, self.settings = model, settings
        self.lost: int | None = None
        """Index of a jet without thrust; attitude is then free, and thrusts need no margin."""
        robot = model.robot
        n, jets = robot.n_joints, len(robot.jets)
        rpy, s = ca.SX.sym("rpy", 3), ca.SX.sym("s", n)
        thrust, margin = ca.SX.sym("T", jets), ca.SX.sym("mu")
        wind, velocity, weights = ca.SX.sym("wind", 3), ca.SX.sym("v", 3), ca.SX.sym("weights", 2)
        self._x = ca.vertcat(rpy, s, thrust, margin)
        self._p = ca.vertcat(wind, velocity, weights)

        self._pairs = clearance.pairs(model.tree, settings.plume_length)
        distances = ca.vertcat(ca.SX(0, 1), *(pair.distance for pair in self._pairs))
        jet_force, link_force = model.generalised_forces()
        held = jet_force + link_force - ca.gradient(model.dynamics.potential, model.tree.q)
        at_rest = model.function("trim_terms", [model.momentum_rate, -held[6:], distances, model.link_wrench])
        motion = ca.vertcat(velocity, ca.SX.zeros(3 + n))
        balance, torque, distances, wrench = at_rest(ca.SX.zeros(3), turn_from_rpy(rpy), s, motion, thrust, wind)
        self._report = ca.Function("trim_report", [self._x, self._p], [balance, torque, distances, wrench])

        rows = self._rows(thrust, margin, balance, torque, distances)
        self._names = rows
        constraints = ca.vertcat(*(row.value / row.scale for row in rows))
        self._least = np.array([row.lower / row.scale for row in rows])
        self._upper = np.array([row.upper / row.scale for row in rows])
        total = ca.sum1(thrust) / (robot.mass * robot.gravity)
        posture = settings.posture_weight * ca.sumsqr(s - ca.DM(settings.posture)) / max(n, 1)
        spread = settings.spread_weight * ca.sumsqr(thrust / ca.DM(robot.thrust_max))
        objective = weights[0] * total - weights[1] * margin + posture + spread
        problem: dict[str, Any] = {"x": self._x, "p": self._p, "f": objective, "g": constraints}
        self._objective = ca.Function("trim_objective", [self._x, self._p], [objective])
        self._constraints = ca.Function("trim_constraints", [self._x, self._p], [constraints])
        self._solver = ca.nlpsol("trim", "ipopt", problem, IPOPT)

        # The elastic problem: constraints may be violated at an L1 cost, so that few are violated.
        over, under = (ca.SX.sym(name, len(rows)) for name in ("over", "under"))
        elastic: dict[str, Any] = {
            "x": ca.vertcat(self._x, over, under),
            "p": self._p,
            "f": ca.sum1(over + under) + 1e-5 * posture,
            "g": constraints + over - under,
        }
        self._elastic = ca.nlpsol("trim_elastic", "ipopt", elastic, IPOPT | {"ipopt.tol": 1e-8})
        self.build_time = time.perf_counter() - started
        """Time to build both problems [s]."""

    def _rows(self, thrust: SX, margin: SX, balance: SX, torque: SX, distances: SX) -> list[_Row]:
        robot, settings = self.model.robot, self.settings
        kinds = [("force", "N", 100.0)] * 3 + [("moment", "N m", 10.0)] * 3
        rows = [
            _Row(f"{kind} balance along {axis}", unit, scale, balance[i], 0.0, 0.0)
            for i, ((kind, unit, scale), axis) in enumerate(zip(kinds, "xyzxyz", strict=True))
        ]
        rows += [
            _Row(f"torque of {name}", "N m", tau, torque[i], -tau, tau)
            for i, (name, tau) in enumerate(zip(robot.joint_names, settings.torque_max.tolist(), strict=True))
        ]
        for i, jet in enumerate(robot.jets):
            top, lower = jet.thrust_max, thrust[i] - margin * jet.thrust_max
            rows.append(_Row(f"lower thrust margin of {jet.name}", "N", top, lower, jet.thrust_min, np.inf))
            rows.append(
                _Row(f"upper thrust margin of {jet.name}", "N", top, (1 - margin) * top - thrust[i], 0.0, np.inf)
            )
        rows += [
            _Row(
                f"distance of {pair.jet} axis from {pair.link}", "m", 0.1, distances[i], settings.clearance_min, np.inf
            )
            for i, pair in enumerate(self._pairs)
        ]
        return rows

    def bounds(self) -> tuple[Array, Array]:
        """Return the limits of the unknowns (rpy, s, T, μ)."""
        settings, robot = self.settings, self.model.robot
        lower, upper = robot.joint_limits.T.copy()
        held = np.setdiff1d(np.arange(robot.n_joints), settings.free_joints)
        # A posture may be slightly outside a limit: the published knees are, by 0.0004 rad.
        lower[held] = upper[held] = settings.posture[held]
        least, top = robot.thrust_min, robot.thrust_max
        low = [settings.roll[0], settings.pitch[0], settings.yaw, *lower, *least, settings.margin_min]
        high = [settings.roll[1], settings.pitch[1], settings.yaw, *upper, *top, 0.5]
        if self.lost is not None:
            # A jet without thrust has no margin, so none is required; attitude is only kept away from gimbal lock.
            jet = 3 + robot.n_joints + self.lost
            low[jet] = high[jet] = 0.0
            low[-1] = high[-1] = 0.0
            low[:2], high[:2] = [-np.pi / 2] * 2, [np.pi / 2] * 2
        return np.array(low), np.array(high)

    def guess(self) -> Array:
        """Return an initial guess: the posture, with the weight shared in proportion to the greatest thrusts."""
        settings, thrust = self.settings, self.model.robot.hover_thrust
        start = np.array([0.0, 0.0, settings.yaw, *settings.posture, *thrust, settings.margin_min])
        low, high = self.bounds()
        return np.asarray(np.clip(start, low, high))

    def solve(
        self,
        wind: ArrayLike,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        objective: Objective = "min_thrust",
        start: TrimResult | None = None,
    ) -> TrimResult:
        """Find the trim in a wind [m/s] at a flight velocity [m/s], both in inertial axes.

        `start` is a nearby trim used as the initial guess.
        """
        weights = (1.0, 0.0) if objective == "min_thrust" else (0.0, 1.0)
        parameters = np.array([*np.asarray(wind), *np.asarray(velocity), *weights])
        low, high = self.bounds()
        x = self.guess()
        if start is not None:
            x = np.concatenate([start.base_rpy, start.joint_position, start.thrust, [start.margin]])
        started = time.perf_counter()
        x, cost, stats = self._run(self._solver, np.clip(x, low, high), parameters, low, high)
        iterations = int(stats["iter_count"])
        message = str(stats["return_status"])
        violations: tuple[Violation, ...] = ()
        if not stats["success"]:
            # Either there is no trim or the solver failed; the elastic problem, which is always feasible, decides.
            nearest, missed_in_total, missed, elastic = self._nearest_point(parameters, low, high)
            iterations += int(elastic["iter_count"])
            violations = self._violations(missed)
            if violations:
                x, cost, message = nearest, missed_in_total, "; ".join(map(str, violations))
            else:
                x, cost, stats = self._run(self._solver, nearest, parameters, low, high)
                iterations += int(stats["iter_count"])
                message = str(stats["return_status"])
                if not stats["success"]:
                    # With redundant equations, or more of them than unknowns, the solver cannot prove an optimum.
                    x = x if self._is_met(x, parameters) else nearest
                    cost = float(self._objective(x, parameters))
                    message = f"equilibrium, not proved to be the best ({message})"
        elapsed = time.perf_counter() - started
        return self._result(x, cost, parameters, message, violations, iterations, elapsed)

    def _run(self, solver: Any, x: Array, p: Array, low: Array, high: Array) -> tuple[Array, float, dict[str, Any]]:
        answer = solver(x0=x, p=p, lbx=low, ubx=high, lbg=self._lower(), ubg=self._upper)
        return np.array(answer["x"].full())[:, 0], float(answer["f"]), solver.stats()

    def _nearest_point(self, p: Array, low: Array, high: Array) -> tuple[Array, float, Array, dict[str, Any]]:
        """Return the point of least total violation, that violation, and the violation of each constraint."""
        count, size = len(self._names), low.size
        start = np.concatenate([self.guess(), np.full(2 * count, 0.1)])
        low = np.concatenate([low, np.zeros(2 * count)])
        high = np.concatenate([high, np.full(2 * count, np.inf)])
        x, cost, stats = self._run(self._elastic, start, p, low, high)
        return x[:size], cost, x[size : size + count] - x[size + count :], stats

    def _lower(self) -> Array:
        lower = self._least.copy()
        if self.lost is not None:
            # A jet without thrust is below its least.
            names = [row.name for row in self._names]
            lower[names.index(f"lower thrust margin of {self.model.robot.jets[self.lost].name}")] = -np.inf
        return lower

    def _is_met(self, x: Array, p: Array) -> bool:
        """Return whether a point satisfies all constraints."""
        values = self._constraints(x, p).full()[:, 0]
        return bool(np.all((values >= self._lower() - TOLERANCE) & (values <= self._upper + TOLERANCE)))

    def _violations(self, missed: Array) -> tuple[Violation, ...]:
        order = np.argsort(-np.abs(missed))
        return tuple(
            Violation(self._names[i].name, abs(float(missed[i])) * self._names[i].scale, self._names[i].unit)
            for i in order
            if abs(missed[i]) > TOLERANCE
        )

    def _result(
        self,
        x: Array,
        cost: float,
        parameters: Array,
        message: str,
        violations: tuple[Violation, ...],
        iterations: int,
        elapsed: float,
    ) -> TrimResult:
        robot = self.model.robot
        n, jets = robot.n_joints, len(robot.jets)
        balance, torque, distances, wrench = (np.array(value.full())[:, 0] for value in self._report(x, parameters))
        thrust = x[3 + n : 3 + n + jets]
        least, top = robot.thrust_min, robot.thrust_max
        nearest = min(range(distances.size), key=lambda pair: float(distances[pair]), default=None)
        return TrimResult(
            feasible=not violations,
            message=message,
            violations=violations,
            at_limit=self._variables_at_limit(x),
            cost=cost,
            base_rpy=x[:3],
            joint_position=x[3 : 3 + n],
            thrust=thrust,
            joint_torque=torque,
            margin=float(np.min(np.minimum(thrust - least, top - thrust) / top, initial=0.5)),
            residual=balance,
            aero_force=wrench[:3],
            aero_moment=wrench[3:],
            clearance=np.inf if nearest is None else float(distances[nearest]),
            closest="" if nearest is None else f"{self._pairs[nearest].jet} to {self._pairs[nearest].link}",
            iterations=iterations,
            solve_time=elapsed,
        )

    def _variables_at_limit(self, x: Array) -> tuple[str, ...]:
        robot = self.model.robot
        names: Sequence[str] = (
            *("roll", "pitch", "yaw"),
            *robot.joint_names,
            *(f"thrust of {jet.name}" for jet in robot.jets),
            "margin",
        )
        low, high = self.bounds()
        span = high - low
        return tuple(
            f"{name} at its {'lower' if value - a <= TOLERANCE * wide else 'upper'} limit"
            for name, value, a, wide in zip(names, x, low, span, strict=True)
            if name != "margin" and wide > 0 and min(value - a, a + wide - value) <= TOLERANCE * wide
        )
