"""Optimal flight between two hovers: centroidal dynamics with aerodynamics, transcribed by collocation."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np
from scipy.integrate import cumulative_trapezoid

from jax_aero.base import tables
from jax_aero.base.terminal import Refused
from jax_aero.symbolic.momentum import MomentumModel
from jax_aero.symbolic.robot import Array, Robot
from jax_aero.symbolic.spatial import SX, turn_from_rpy

IPOPT: dict[str, Any] = {
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-6,
    "ipopt.constr_viol_tol": 1e-7,
    "ipopt.max_iter": 500,
    "ipopt.mu_strategy": "adaptive",
    "print_time": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
}


SMOOTHER = 5.0
"""Factor on the weights of effort and posture in the first of two solutions. Ours."""


class Consumption(tables.Table, frozen=True):
    """Fuel consumption of a jet, linear in its thrust, through two points."""

    thrust: tables.Interval
    """Thrusts [N]."""
    consumption: tuple[tables.NonNegative, tables.NonNegative]
    """Consumption at these thrusts [l/min]."""


class TrajectoryConfig(tables.Table, frozen=True):
    """An optimal flight between two points: objective and limits."""

    title: str
    goal: Literal["min_time", "min_fuel"]
    flight: Path
    """Experiment that defines robot, aerodynamics, posture and wind, and with which the plan is compared."""
    start_time: tables.NonNegative
    """Time at which the motion begins [s]."""
    hold_time: tables.NonNegative
    """Duration of the final hover [s]."""
    start: tuple[float, float, float]
    """Centre of mass at the initial hover [m]."""
    end: tuple[float, float, float]
    """Centre of mass at the final hover [m]."""
    free_groups: tuple[str, ...]
    """Joint groups that vector the thrust."""
    yaw_deg: float
    yaw_slack_deg: tables.NonNegative
    """Largest deviation of yaw from its initial value [deg]."""
    roll_limits_deg: tables.Interval
    pitch_limits_deg: tables.Interval
    angular_velocity_max_deg: tables.Positive
    """Greatest rate of roll, pitch and yaw [deg/s]."""
    moment_max: tables.Positive
    """Greatest net moment about each axis through the centre of mass [N m], since attitude feedback is limited."""
    acceleration_max: tables.Positive
    """Greatest acceleration along each axis [m/s²]."""
    speed_max: tables.Positive
    """Greatest speed [m/s]."""
    sideways_max: tables.Positive
    """Largest distance of the centre of mass from the range of y between start and end [m]."""
    height_min: float
    """Least height of the centre of mass [m]."""
    thrust_reserve: tables.Fraction
    """Margin of every thrust from both its limits, as a fraction of its greatest value, left to feedback."""
    thrust_rate_max: tables.Positive
    """Greatest thrust rate [N/s]."""
    joint_velocity_max_deg: tables.Positive
    """Greatest joint velocity [deg/s]."""
    duration_range: tables.Interval
    """Least and greatest duration [s]."""
    intervals: tables.Count
    """Number of collocation intervals."""
    degree: tables.Count
    """Number of Radau points per interval."""
    effort_weight: tables.NonNegative
    """Weight of the squared thrust rates and joint velocities, each relative to its limit, integrated over time."""
    posture_weight: tables.NonNegative
    """Weight of |s − s₀|²/n, integrated over time [1/rad²]; the controller also pulls joints back to the posture."""
    sample_time: tables.Positive
    """Time between samples of the solved flight [s]."""
    fuel: Path
    """File with the consumption of every jet, such as `configs/tables/fuel.toml`."""


def load_fuel(path: Path) -> dict[str, Consumption]:
    """Read the consumption of every jet, by name."""
    return {name: tables.convert(points, Consumption, path.name) for name, points in tables.read(path).items()}


def fuel_lines(fuel: Mapping[str, Consumption], robot: Robot) -> tuple[Array, Array]:
    """Return the consumption of each jet at zero thrust [l/s] and its slope [l/(s N)]."""
    names = [jet.name for jet in robot.jets]
    if set(fuel) != set(names):
        raise Refused(f"`fuel` has {', '.join(fuel)}; expected one table for each jet: {', '.join(names)}")
    slopes, starts = [], []
    for name in names:
        (c0, c1), thrust = fuel[name].consumption, fuel[name].thrust
        slope = (c1 - c0) / (thrust.upper - thrust.lower) / 60.0
        slopes.append(slope)
        starts.append(c0 / 60.0 - slope * thrust.lower)
    return np.array(starts), np.array(slopes)


def fuel_burnt(times: Any, thrust: Any, idle: Any, slope: Any) -> Any:
    """Return the fuel burnt up to each time [l]: the integral of idle + slope T over all jets, by trapezoids."""
    return cumulative_trapezoid(idle.sum() + thrust @ slope, times, initial=0)


@dataclass(frozen=True)
class Trajectory:
    """A solved flight, evenly sampled; inertial axes."""

    success: bool
    message: str
    """Message of the solver, with the most violated constraint if it failed."""
    duration: float
    """Duration [s]."""
    fuel: float
    """Fuel burnt [l]."""
    time: Array
    """(k,) [s]."""
    com: Array
    """(k, 4, 3) position, velocity, acceleration and jerk of the centre of mass [m, m/s, m/s², m/s³]."""
    base_rpy: Array
    """(k, 3) [rad]."""
    angular_momentum: Array
    """(k, 3) about the centre of mass [kg m²/s]."""
    thrust: Array
    """(k, jets) [N]."""
    thrust_rate: Array
    """(k, jets) [N/s]."""
    joint_position: Array
    """(k, n) [rad]."""
    joint_velocity: Array
    """(k, n) [rad/s]."""
    defect: float
    """Largest constraint violation of the solution, in the scaled units of the problem."""
    iterations: int
    build_time: float
    solve_time: float


class CentroidalFlight:
    """The centroidal dynamics as a controlled system ẋ = f(x, u).

        x = (p_G, v_G, rpy, k, T, s)      centre of mass, its velocity, base attitude, angular momentum, thrusts, joints
        u = (Ṫ, ṡ)

    The angular velocity ω satisfies A_ω ω + A_s ṡ = k. Only the free joints appear.
    """

    def __init__(self, model: MomentumModel, posture: Array, free_joints: tuple[int, ...]) -> None:
        robot = model.robot
        jets, free, n = len(robot.jets), list(free_joints), robot.n_joints
        self.sizes = (3, 3, 3, 3, jets, len(free))
        self.nx, self.nu = sum(self.sizes), jets + len(free)
        x, u, wind = ca.SX.sym("x", self.nx), ca.SX.sym("u", self.nu), ca.SX.sym("w", 3)
        _, v, rpy, k, thrust, s_free = ca.vertsplit(x, [0, *np.cumsum(self.sizes).tolist()])
        thrust_rate, s_dot_free = ca.vertsplit(u, [0, jets, self.nu])
        s, s_dot = ca.SX(ca.DM(posture)), ca.SX.zeros(n)
        if free:
            s[free], s_dot[free] = s_free, s_dot_free

        # Momentum is linear in (ω, ṡ): a part from the rotation of the whole body and a part from the joints alone.
        dynamics = model.dynamics
        of_body = model.function("of_body", [dynamics.locked_inertia, dynamics.com])
        of_motion = model.function("of_motion", [dynamics.momentum])
        balance = model.function("momentum_rate", [model.momentum_rate])
        here, turn = ca.SX.zeros(3), turn_from_rpy(rpy)
        inertia, arm = of_body(here, turn, s, ca.SX.zeros(6 + n), thrust, wind)
        joints = of_motion(here, turn, s, ca.vertcat(ca.SX.zeros(6), s_dot), thrust, wind)
        omega = ca.mtimes(_inverse(inertia), k - joints[3:])
        drift = ca.cross(omega, arm) + joints[:3] / robot.mass  # of the centre of mass, relative to the base
        rate = balance(here, turn, s, ca.vertcat(v - drift, omega, s_dot), thrust, wind)
        rpy_rate = ca.mtimes(_inverse(_angular_velocity_matrix(rpy)), omega)
        x_dot = ca.vertcat(v, rate[:3] / robot.mass, rpy_rate, rate[3:], thrust_rate, s_dot_free)
        u_dot = ca.SX.sym("u_dot", self.nu)
        jerk = ca.jtimes(x_dot[3:6], ca.vertcat(x, u), ca.vertcat(x_dot, u_dot))
        self.f = ca.Function("f", [x, u, wind], [x_dot])
        self.jerk = ca.Function("jerk", [x, u, u_dot, wind], [jerk])


def _angular_velocity_matrix(rpy: SX) -> SX:
    """Return W with ω = W d(rpy)/dt, from S(ω) = Ṙ Rᵀ."""
    rate, turn = ca.SX.sym("rate", 3), turn_from_rpy(rpy)
    spin = ca.mtimes(ca.reshape(ca.jtimes(ca.vec(turn), rpy, rate), 3, 3), turn.T)
    return ca.jacobian(ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0]), rate)


def _inverse(a: SX) -> SX:
    """Invert a 3 × 3 matrix by cofactors."""
    one, two, three = ca.horzsplit(a)
    rows = ca.horzcat(ca.cross(two, three), ca.cross(three, one), ca.cross(one, two)).T
    return rows / ca.dot(one, ca.cross(two, three))


class TrajectoryProblem:
    """Radau collocation of a `CentroidalFlight` of free duration between two hovers.

    States are continuous, polynomial on every interval; inputs are continuous and linear on every interval, so
    acceleration is continuous too. Both ends are upright equilibria without input: v = 0, k = 0, v̇ = 0, k̇ = 0, u = 0.

    Parameters
    ----------
    wind
        (3,) steady wind [m/s].
    posture
        (n,) positions of the fixed joints, and initial positions of the free ones [rad].
    free_joints
        Joints that vector the thrust, from `config.free_groups`.
    """

    def __init__(
        self, model: MomentumModel, config: TrajectoryConfig, wind: Array, posture: Array, free_joints: tuple[int, ...]
    ) -> None:
        started = time.perf_counter()
        self.model, self.config, self.wind, self.posture, self.free_joints = model, config, wind, posture, free_joints
        self.fuel_idle, self.fuel_slope = fuel_lines(load_fuel(config.fuel), model.robot)
        self.rate_limits = np.concatenate(
            [
                np.full(len(model.robot.jets), config.thrust_rate_max),
                np.full(len(free_joints), np.radians(config.joint_velocity_max_deg)),
            ]
        )
        self.system = system = CentroidalFlight(model, posture, free_joints)
        count, degree = config.intervals, config.degree
        points = [0.0, *ca.collocation_points(degree, "radau")]
        self._points = np.array(points)
        slopes = _lagrange_derivatives(self._points)

        first = ca.MX.sym("x0", system.nx)
        inner = ca.MX.sym("x", system.nx, count * degree)  # the last Radau point of an interval is its end
        inputs = ca.MX.sym("u", system.nu, count + 1)
        duration = ca.MX.sym("duration")
        h = duration / count

        blend = [ca.DM(self._points[1:]).T] * count
        left = ca.horzcat(*(ca.repmat(inputs[:, i], 1, degree) for i in range(count)))
        right = ca.horzcat(*(ca.repmat(inputs[:, i + 1], 1, degree) for i in range(count)))
        weight = ca.repmat(ca.horzcat(*blend), system.nu, 1)
        u_inner = left * (1 - weight) + right * weight
        air = ca.DM(wind)
        rates = system.f.map(count * degree)(inner, u_inner, ca.repmat(air, 1, count * degree))
        defects = []
        for i in range(count):
            block = inner[:, i * degree : (i + 1) * degree]
            start = first if i == 0 else inner[:, i * degree - 1]
            moved = ca.mtimes(ca.horzcat(start, block), ca.DM(slopes[:, 1:]))
            defects.append(moved - h * rates[:, i * degree : (i + 1) * degree])
        ends = [system.f(x, u, air) for x, u in ((first, inputs[:, 0]), (inner[:, -1], inputs[:, -1]))]
        balance = [ca.vertcat(end[3:6], end[9:12]) for end in ends]
        turning, moment = rates[6:9, :], rates[9:12, :]
        speed = ca.sum1(inner[3:6, :] ** 2)
        spin = float(np.radians(config.angular_velocity_max_deg))
        self._rows = [
            ("dynamics", ca.vec(ca.horzcat(*defects)), 0.0, 0.0),
            ("equilibrium at the start", balance[0], 0.0, 0.0),
            ("equilibrium at the end", balance[1], 0.0, 0.0),
            ("angular velocity", ca.vec(turning), -spin, spin),
            ("moment", ca.vec(moment), -config.moment_max, config.moment_max),
            ("acceleration", ca.vec(rates[3:6, :]), -config.acceleration_max, config.acceleration_max),
            ("speed", ca.vec(speed), 0.0, config.speed_max**2),
        ]

        quadrature = _radau_weights(self._points)
        shares = ca.repmat(ca.DM(quadrature), count, 1)
        burn = sum(float(i) for i in self.fuel_idle) + ca.mtimes(
            ca.DM(self.fuel_slope).T, inner[12 : 12 + len(model.robot.jets), :]
        )
        limits = ca.repmat(ca.DM(self.rate_limits), 1, count * degree)
        effort = ca.mtimes(ca.sum1((u_inner / limits) ** 2), shares) * h
        fuel = ca.mtimes(burn, shares) * h
        self._fuel = ca.Function("fuel", [inner, duration], [fuel])
        # Fuel as the duration of a hover that burns as much, so that effort has equal weight in both objectives.
        weights = ca.MX.sym("weights", 4)
        hover_burn = float(self.fuel_idle.sum() + self.fuel_slope @ model.robot.hover_thrust)
        cost = weights[0] * duration + weights[1] * fuel / hover_burn + weights[2] * effort
        if free_joints:
            away = inner[12 + len(model.robot.jets) :, :] - ca.DM(posture[list(free_joints)])
            cost += weights[3] * h * ca.mtimes(ca.sum1(away**2), shares) / len(free_joints)
        self._unpack = ca.Function(
            "unpack", [ca.veccat(first, inner, inputs, duration)], [first, inner, inputs, duration]
        )
        problem: dict[str, Any] = {
            "x": ca.veccat(first, inner, inputs, duration),
            "p": weights,
            "f": cost,
            "g": ca.vertcat(*(row[1] for row in self._rows)),
        }
        self._solver = ca.nlpsol("trajectory", "ipopt", problem, IPOPT)
        self.build_time = time.perf_counter() - started

    def _bounds(self) -> tuple[Array, Array]:
        config, robot = self.config, self.model.robot
        top = robot.thrust_max
        reach = np.inf
        yaw, slack = np.radians(config.yaw_deg), np.radians(config.yaw_slack_deg)
        roll, pitch = config.roll_limits_deg.radians, config.pitch_limits_deg.radians
        joints = robot.joint_limits[list(self.free_joints)]
        reserve = config.thrust_reserve * top
        left = sorted((config.start[1], config.end[1]))
        sides = (left[0] - config.sideways_max, left[1] + config.sideways_max)
        low = np.array([-reach, sides[0], config.height_min, *[-reach] * 3, roll[0], pitch[0], yaw - slack])
        high = np.array([reach, sides[1], reach, *[reach] * 3, roll[1], pitch[1], yaw + slack])
        low = np.concatenate([low, [-reach] * 3, robot.thrust_min + reserve, joints[:, 0]])
        high = np.concatenate([high, [reach] * 3, top - reserve, joints[:, 1]])

        def hover(at: tuple[float, float, float]) -> tuple[Array, Array]:
            fixed = np.array([*at, 0, 0, 0, 0, 0, yaw, 0, 0, 0], dtype=float)
            return np.concatenate([fixed, low[12:]]), np.concatenate([fixed, high[12:]])

        first, last = hover(config.start), hover(config.end)
        rates, still = self.rate_limits, np.zeros(self.system.nu)
        count, middle = config.intervals, config.intervals * config.degree - 1
        shortest, longest = config.duration_range.lower, config.duration_range.upper
        lower: list[Any] = [first[0], *[low] * middle, last[0], still, *[-rates] * (count - 1), still, [shortest]]
        upper: list[Any] = [first[1], *[high] * middle, last[1], still, *[rates] * (count - 1), still, [longest]]
        return np.concatenate(lower), np.concatenate(upper)

    def _guess(self) -> Array:
        """Return an initial guess: minimum-jerk motion along the line, upright, weight shared by greatest thrust."""
        config, robot = self.config, self.model.robot
        count = config.intervals
        duration = 0.5 * (config.duration_range.lower + config.duration_range.upper)
        tau = (np.arange(count)[:, None] + self._points[1:]).ravel() / count
        tau = np.concatenate([[0.0], tau])[:, None]
        start = np.array(config.start)
        way = np.array(config.end) - start
        p = start + way * tau**3 * (10 - 15 * tau + 6 * tau**2)
        v = way * 30 * tau**2 * (1 - tau) ** 2 / duration
        yaw = np.radians(config.yaw_deg)
        rest = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0, *robot.hover_thrust])
        rest = np.concatenate([rest, self.posture[list(self.free_joints)]])
        x = np.hstack([p, v, np.tile(rest, (tau.size, 1))])
        return np.concatenate([x.ravel(), np.zeros(self.system.nu * (count + 1)), [duration]])

    def solve(self) -> Trajectory:
        """Solve the problem twice and sample the second solution.

        The first solution minimises time with `SMOOTHER` times the weights of effort and posture, so that both
        objectives start from the same smooth flight and reach the same local minimum; the second is as configured.
        """
        config = self.config
        regular = np.array([config.effort_weight, config.posture_weight])
        time_and_fuel = (1.0, 0.0) if config.goal == "min_time" else (0.0, 1.0)
        lower, upper = self._bounds()
        row_lower = np.concatenate([np.full(row[1].numel(), row[2]) for row in self._rows])
        row_upper = np.concatenate([np.full(row[1].numel(), row[3]) for row in self._rows])
        started = time.perf_counter()
        bounds = {"lbx": lower, "ubx": upper, "lbg": row_lower, "ubg": row_upper}
        guess = np.clip(self._guess(), lower, upper)
        first = self._solver(x0=guess, p=[1.0, 0.0, *(SMOOTHER * regular)], **bounds)
        iterations = int(self._solver.stats()["iter_count"])
        answer = self._solver(x0=first["x"], p=[*time_and_fuel, *regular], **bounds)
        elapsed = time.perf_counter() - started
        stats: Mapping[str, Any] = self._solver.stats() | {
            "iter_count": iterations + self._solver.stats()["iter_count"]
        }
        g = np.array(answer["g"].full())[:, 0]
        missed = np.maximum(np.maximum(row_lower - g, g - row_upper), 0.0)
        message = str(stats["return_status"])
        if not stats["success"]:
            worst = int(np.argmax(missed))
            ends = np.cumsum([row[1].numel() for row in self._rows])
            name = self._rows[int(np.searchsorted(ends, worst, side="right"))][0]
            message += f"; {name} missed by {missed[worst]:.3g}"
        return self._sample(answer["x"], stats, message, float(missed.max()), elapsed)

    def _sample(self, x: Any, stats: Mapping[str, Any], message: str, defect: float, elapsed: float) -> Trajectory:
        config, system, robot = self.config, self.system, self.model.robot
        first, inner, inputs, duration_dm = (np.array(value.full()) for value in self._unpack(x))
        duration = float(duration_dm[0, 0])
        count, degree = config.intervals, config.degree
        h = duration / count
        steps = max(2, int(np.ceil(duration / config.sample_time)) + 1)
        t = np.linspace(0.0, duration, steps)
        which = np.minimum((t / h).astype(int), count - 1)
        local = t / h - which
        states = np.empty((steps, system.nx))
        for sample, (interval, tau) in enumerate(zip(which, local, strict=True)):
            start = first if interval == 0 else inner[:, interval * degree - 1 : interval * degree]
            block = np.hstack([start, inner[:, interval * degree : (interval + 1) * degree]])
            states[sample] = block @ _lagrange(self._points, tau)
        u = inputs[:, which] * (1 - local) + inputs[:, which + 1] * local
        u_dot = (inputs[:, which + 1] - inputs[:, which]) / h
        wind = np.tile(self.wind[:, None], (1, steps))
        rates = np.array(system.f.map(steps)(states.T, u, wind).full()).T
        jerk = np.array(system.jerk.map(steps)(states.T, u, u_dot, wind).full()).T
        jets, free = len(robot.jets), list(self.free_joints)
        joints, joint_rates = np.tile(self.posture, (steps, 1)), np.zeros((steps, robot.n_joints))
        joints[:, free], joint_rates[:, free] = states[:, 12 + jets :], u.T[:, jets:]
        return Trajectory(
            success=bool(stats["success"]),
            message=message,
            duration=duration,
            fuel=float(self._fuel(inner, duration)),
            time=t,
            com=np.stack([states[:, :3], states[:, 3:6], rates[:, 3:6], jerk], axis=1),
            base_rpy=states[:, 6:9],
            angular_momentum=states[:, 9:12],
            thrust=states[:, 12 : 12 + jets],
            thrust_rate=u.T[:, :jets],
            joint_position=joints,
            joint_velocity=joint_rates,
            defect=defect,
            iterations=int(stats["iter_count"]),
            build_time=self.build_time,
            solve_time=elapsed,
        )


def _lagrange(points: Array, at: float) -> Array:
    """Return the values at one abscissa of the Lagrange polynomials of the points."""
    gaps = points[:, None] - points[None, :]
    np.fill_diagonal(gaps, 1.0)
    factors = np.tile(at - points, (points.size, 1))
    np.fill_diagonal(factors, 1.0)
    return np.asarray(factors.prod(axis=1) / gaps.prod(axis=1))


def _lagrange_derivatives(points: Array) -> Array:
    """Return the derivative of Lagrange polynomial i at point j."""
    powers = np.polynomial.polynomial.polyvander(points, points.size - 1)
    coefficients = np.linalg.inv(powers)
    slopes = np.polynomial.polynomial.polyder(coefficients, axis=0)
    return np.asarray(np.polynomial.polynomial.polyval(points, slopes))


def _radau_weights(points: Array) -> Array:
    """Return the weights of the inner points for the integration of polynomials over [0, 1]."""
    inner = points[1:]
    moments = 1.0 / np.arange(1, inner.size + 1)
    return np.asarray(np.linalg.solve(np.vander(inner, increasing=True).T, moments), dtype=np.float64)
