"""The fall of a robot after one of its engines stops: the optimal control problem, and its limits."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.robot.groups import joints_of
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.spatial import turn_from_rpy
from jax_aero.symbolic.trajectory import IPOPT, CentroidalFlight

Array = NDArray[np.float64]

HEIGHT, DOWNWARDS, TURN = 2, 5, slice(6, 9)
"""Entries of the state of a `CentroidalFlight`."""
EFFORT = 1e-3
"""Weight of squared joint velocities, relative to their limit, over time [m/s]: it selects one of equal falls. Ours."""
GROUPS = ("torso", "left_arm", "right_arm")
"""Joint groups that move."""
JOINT_VELOCITY_MAX = np.radians(150.0)
"""As in the recommended controller's descent [rad/s]."""
DOWNWARDS_MAX, SIDEWAYS_MAX, LEAN_MAX = 1.5, 1.0, np.radians(30.0)
"""Limits of a landing, as in the simulator [m/s, m/s, rad]."""
LONGEST = 12.0
"""Greatest duration of a descent to the ground [s]."""


class HeightLost(tables.Table, frozen=True):
    """Falls to compute."""

    experiments: tuple[str, ...] = ("robot", "mk3_robot")
    engines: tuple[str, ...] = ("l_arm_jet", "chest_l_jet")
    time: tables.Positive = 18.0
    """When the engine stops [s]."""
    reaction: tables.Positive = 0.1
    """Time without reaction [s]."""
    others: tuple[tuple[tables.Positive, tables.Positive], ...] = (
        *((1.0, 1.0), (0.5, 1.0), (0.25, 1.0)),
        *((1.0, 1.1), (1.0, 1.2)),
    )
    """Times that the other engines take, and thrusts that they have, relative to theirs."""
    intervals: Annotated[int, msgspec.Meta(ge=2)] = 16
    hovers: tuple[tables.Positive, ...] = (1.0, 2.0, 5.0)
    """Heights of hovers that end with a touchdown [m]."""
    moments: tuple[tables.Positive, ...] = (28.0, 33.0)
    """Times on the way of the mission after which one does [s]: fast, and braking."""
    sinking: tuple[tables.Positive, ...] = (0.3, 0.6, 1.0, 1.6, 2.2, 3.0, 4.0)
    """Heights above the ground at which the engine of a sinking robot stops [m]."""
    speed_max: tables.Positive = 1.6
    """Greatest speed downwards that is flown [m/s]."""
    halvings: tables.Count = 4
    """Of the range of flown speeds."""
    robots: tables.Count = 8
    """Perturbed robots for each flown speed."""
    seed: tables.Seed = 1

    def __post_init__(self) -> None:
        tables.check_levels(self, "experiments", "engines", "others", "hovers", "moments", "sinking")


class Landing(NamedTuple):
    """The end of a fall; NaN where there is none."""

    height: float = np.nan
    """Height lost [m]."""
    duration: float = np.nan
    """Since the engine stopped [s]."""
    downwards: float = np.nan
    """Greatest speed downwards on the way [m/s]."""
    lean: float = np.nan
    """Greatest lean on the way [deg]."""


class Touchdown(NamedTuple):
    """The end of a fall on the ground; NaN where there is none."""

    downwards: float = np.nan
    """Speed downwards [m/s]."""
    sideways: float = np.nan
    """Horizontal speed [m/s]."""
    lean: float = np.nan
    """Lean [deg]."""
    duration: float = np.nan
    """Since the engine stopped [s]."""
    steepest: float = np.nan
    """Greatest lean on the way [deg]."""


UNITS = {
    Landing: dict(zip(Landing._fields, ("m", "s", "m s-1", "deg"), strict=True)),
    Touchdown: dict(zip(Touchdown._fields, ("m s-1", "m s-1", "deg", "s", "deg"), strict=True)),
}


class Fall:
    """The fall of one robot without an engine that stops at a time [s] of its flight.

        X = (x, Ṫ), x of `CentroidalFlight`;  U = (v(u), ṡ);  T̈ = κ/τ² (f + g v)(T/κ, τ Ṫ/κ)        M32

    with engines whose thrust is κ times, and whose time τ times theirs. States are continuous, inputs linear on every
    interval, and the dynamics hold by the trapezoidal rule.
    """

    def __init__(self, asked: HeightLost, config: rust.Config, time: float, engine: str) -> None:
        self.asked, robot = asked, load_robot(config["robot"])
        log = rust.fly(flight_of(config, time)).log
        free = list(joints_of(config["robot"], GROUPS))
        posture, jets = log["joint_position"][-1], [jet.name for jet in robot.jets]
        system = CentroidalFlight(MomentumModel(robot, config["controller"]["aero"]), posture, tuple(free))
        names = rust.Robot(config["robot"]).arrays()["jets"]["engines"]
        given = tables.read(config["robot"])["engines"]
        engines = [None if jet == engine else given[name] for jet, name in zip(jets, names, strict=True)]

        self.size = system.nx + len(jets)
        x, u, scales = ca.SX.sym("x", self.size), ca.SX.sym("u", system.nu), ca.SX.sym("p", 2)
        rates, wind = x[system.nx :], ca.DM(log["wind"][-1])
        thrust = slice(12, 12 + len(jets))
        accelerations = [
            ca.SX(0) if one is None else _acceleration(one, x[thrust][jet], rates[jet], u[jet], scales)
            for jet, one in enumerate(engines)
        ]
        x_dot = ca.vertcat(system.f(x[: system.nx], ca.vertcat(rates, u[len(jets) :]), wind), *accelerations)
        self.f = ca.Function("f", [x, u, scales], [x_dot])
        self.upright = ca.Function("upright", [x], [turn_from_rpy(x[TURN])[2, 2]])

        rpy = Rotation.from_quat(np.roll(log["base_quaternion"][-1], -1)).as_euler("xyz")
        running = np.array([one is not None for one in engines])
        com = (log["com_position"][-1], log["com_velocity"][-1], rpy, log["momentum"][-1][3:])
        self.start = np.concatenate([*com, running * log["thrust"][-1], posture[free], np.zeros(len(jets))])
        self.height, self.ground = float(self.start[HEIGHT]), float(log["com_position"][0, HEIGHT])
        held = ca.vertcat(system.f(x[: system.nx], ca.DM.zeros(system.nu), wind), ca.DM.zeros(len(jets)))
        flown = ca.integrator("flown", "cvodes", {"x": x, "ode": held}, 0.0, asked.reaction)(x0=self.start)
        self.start = np.array(flown["xf"].full())[:, 0]

        self.lower, self.upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        self.lower[TURN], self.upper[TURN] = [-1.5, -1.5, -np.inf], [1.5, 1.5, np.inf]  # away from gimbal lock
        self.lower[thrust], self.upper[thrust] = 0.0, running * robot.thrust_max
        joints = slice(thrust.stop, system.nx)
        self.lower[joints], self.upper[joints] = robot.joint_limits[free].T
        self.thrust, fast = thrust, np.full(len(free), JOINT_VELOCITY_MAX)
        throttles = ("throttle_min", "throttle_max")
        ends = np.array([[0.0, 0.0] if one is None else [_input(one, one[of]) for of in throttles] for one in engines])
        self.inputs = np.concatenate([ends[:, 0], -fast]), np.concatenate([ends[:, 1], fast])
        self.still = np.concatenate([ends[:, 0], 0 * fast]), np.concatenate([ends[:, 1], 0 * fast])
        self.jets = len(jets)

    def _end(self, x: Any, x_dot: Any) -> tuple[Any, Array, Array]:
        """Return rows that hold at the end of a fall, and their limits: level, slow, steady, balanced."""
        rows = ca.vertcat(self.upright(x), ca.sumsqr(x[3:5]), x_dot[DOWNWARDS], x_dot[TURN], x_dot[9:12])
        lower = [np.cos(LEAN_MAX), 0.0, 0.0, *[0.0] * 6]
        return rows, np.array(lower), np.array([np.inf, SIDEWAYS_MAX**2, np.inf, *[0.0] * 6])

    @cached_property
    def path(self) -> tuple[Any, ...]:
        """States, inputs and duration of a fall, its scales, its defects, and the integral of its effort."""
        count = self.asked.intervals
        x, u = ca.MX.sym("x", self.size, count + 1), ca.MX.sym("u", self.inputs[0].size, count + 1)
        scales, duration = ca.MX.sym("p", 2), ca.MX.sym("duration")
        x_dot, h = self.f.map(count + 1)(x, u, ca.repmat(scales, 1, count + 1)), duration / count
        defects = ca.vec(x[:, 1:] - x[:, :-1] - 0.5 * h * (x_dot[:, 1:] + x_dot[:, :-1]))
        return x, u, duration, scales, x_dot, defects, EFFORT * h * ca.sumsqr(u[self.jets :, :] / JOINT_VELOCITY_MAX)

    @cached_property
    def _least(self) -> tuple[Any, Array, Array]:
        """The search for the least height lost, and the limits of its rows."""
        x, u, duration, scales, x_dot, defects, effort = self.path
        end, lower, upper = self._end(x[:, -1], x_dot[:, -1])
        problem = {"x": ca.veccat(x, u, duration), "p": scales, "f": self.height - x[HEIGHT, -1] + effort}
        solver = ca.nlpsol("fall", "ipopt", {**problem, "g": ca.vertcat(defects, end)}, IPOPT)
        none = np.zeros(defects.numel())
        return solver, np.concatenate([none, lower]), np.concatenate([none, upper])

    @cached_property
    def _gentlest(self) -> tuple[Any, Array, Array]:
        """The search for the touchdown that is least beyond the limits of a landing, and the limits of its rows.

        It minimises σ, the greatest of `-v_z/1.5`, `|v_xy|/1.0` and `(1 - cos θ)/(1 - cos 30°)`.
        """
        x, u, duration, scales, _, defects, effort = self.path
        sigma, end = ca.MX.sym("sigma"), x[:, -1]
        lean = (1.0 - self.upright(end)) / (1.0 - np.cos(LEAN_MAX))
        beyond = ca.vertcat(-end[DOWNWARDS] / DOWNWARDS_MAX - sigma, lean - sigma)
        beyond = ca.vertcat(beyond, ca.sumsqr(end[3:5] / SIDEWAYS_MAX) - sigma**2, self.ground - x[HEIGHT, :].T)
        problem = {"x": ca.veccat(x, u, duration, sigma), "p": scales, "f": sigma + effort}
        solver = ca.nlpsol(
            "touchdown", "ipopt", {**problem, "g": ca.vertcat(defects, end[HEIGHT] - self.ground, beyond)}, IPOPT
        )
        zero = np.zeros(defects.numel() + 1)
        return solver, np.concatenate([zero, np.full(beyond.numel(), -np.inf)]), np.pad(zero, (0, beyond.numel()))

    @cached_property
    def _strongest(self) -> tuple[Any, Array, Array]:
        """The search for the state in which the robot is accelerated upwards most, and the limits of its rows."""
        alone, scales = ca.MX.sym("xu", self.size + self.inputs[0].size), ca.MX.sym("p", 2)
        x_dot = self.f(alone[: self.size], alone[self.size :], scales)
        rows, lower, upper = self._end(alone[: self.size], x_dot)
        lower[2] = -np.inf
        problem = {"x": alone, "p": scales, "f": -x_dot[DOWNWARDS], "g": rows}
        return ca.nlpsol("best", "ipopt", problem, IPOPT), lower, upper

    def greatest_acceleration(self, thrust: float) -> float:
        """Return the greatest acceleration upwards in a state in which the fall may end [m/s²]."""
        (_, last), inputs = self._bounds(thrust), np.array(self.still)
        guess = np.concatenate([np.clip(self.start, *last), inputs.mean(axis=0)])
        bounds = [np.concatenate(pair) for pair in zip(last, inputs, strict=True)]
        solution = solved(self._strongest, guess, [1.0, thrust], *bounds)
        return np.nan if solution is None else -solution[1]

    def _bounds(self, thrust: float) -> list[tuple[Array, Array]]:
        """Return the bounds of the states on the way and at the end: a fall does not climb again."""
        high, low = self.upper.copy(), self.lower.copy()
        high[self.thrust] *= thrust
        high[DOWNWARDS] = 0.0
        low[DOWNWARDS] = -DOWNWARDS_MAX
        return [(self.lower, high), (low, high)]

    def guess(self, high: Array, drop: float) -> Array:
        """Return a fall of a height [m] on which all thrusts rise towards their greatest."""
        count = self.asked.intervals
        path = np.tile(self.start, (count + 1, 1))
        path[:, self.thrust] += np.linspace(0.0, 0.8, count + 1)[:, None] * (high - self.start)[self.thrust]
        path[:, HEIGHT] -= np.linspace(0.0, drop, count + 1)
        return np.concatenate([path.ravel(), np.tile(np.mean(self.inputs, axis=0), count + 1), [1.5]])

    def _leans(self, solution: Array) -> tuple[Array, Array]:
        """Return the states of a fall (k, n), and the lean in each [deg]."""
        count = self.asked.intervals + 1
        path = solution[: self.size * count].reshape(count, self.size)
        return path, np.degrees(np.arccos(np.clip(self.upright.map(count)(path.T).full()[0], -1.0, 1.0)))

    def solve(self, spool_up: float, thrust: float, guess: Array | None = None) -> tuple[Landing, Array | None]:
        """Return the highest landing and the unknowns, `None` if there is none; `guess` are those of another one."""
        count, (way, last) = self.asked.intervals, self._bounds(thrust)
        if not self.greatest_acceleration(thrust) >= 0.0:
            return Landing(), None
        lower, upper = (
            np.concatenate([self.start, *[on] * (count - 1), end, *[u] * count, still, [duration]])
            for on, end, u, still, duration in zip(way, last, self.inputs, self.still, (0.1, 6.0), strict=True)
        )
        guess = self.guess(way[1], 0.0) if guess is None else guess
        answer = solved(self._least, guess, [spool_up, thrust], lower, upper)
        if answer is None:
            return Landing(), None
        (path, leans), duration = self._leans(answer[0]), answer[0][-1] + self.asked.reaction
        height = self.height - path[-1, HEIGHT]
        return Landing(float(height), float(duration), float(-path[:, DOWNWARDS].min()), float(leans.max())), answer[0]

    def touch_down(self, thrust: float = 1.0) -> Touchdown:
        """Return the gentlest touchdown."""
        count, high = self.asked.intervals, self.upper.copy()
        high[self.thrust] *= thrust
        lower, upper = (
            np.concatenate([self.start, *[on] * count, *[u] * (count + 1), last])
            for on, u, last in zip((self.lower, high), self.inputs, ((0.1, 0.0), (LONGEST, np.inf)), strict=True)
        )
        guess = np.append(self.guess(high, self.height - self.ground), 1.0)
        answer = solved(self._gentlest, guess, [1.0, thrust], lower, upper)
        if answer is None:
            return Touchdown()
        (path, leans), duration = self._leans(answer[0]), answer[0][-2] + self.asked.reaction
        sideways = float(np.linalg.norm(path[-1, 3:5]))
        return Touchdown(float(-path[-1, DOWNWARDS]), sideways, float(leans[-1]), float(duration), float(leans.max()))


def solved(problem: tuple[Any, Array, Array], guess: Array, p: list[float], low: Array, high: Array) -> Any:
    """Return unknowns and cost of an optimum, `None` where the solver finds none."""
    solver, lower, upper = problem
    answer = solver(x0=guess, p=p, lbx=low, ubx=high, lbg=lower, ubg=upper)
    return (np.array(answer["x"].full())[:, 0], float(answer["f"])) if solver.stats()["success"] else None


def _input(engine: dict[str, float], throttle: float) -> float:
    """Return v(u)."""
    return throttle * (1.0 + engine["b_uu"] * throttle)


def _acceleration(k: dict[str, float], thrust: Any, rate: Any, v: Any, scales: Any) -> Any:
    """Return T̈ of an engine κ times as strong that takes τ times as long."""
    tau, kappa = ca.vertsplit(scales)
    t, d = thrust / kappa, rate * tau / kappa
    drift = k["k_t"] * t + k["k_tt"] * t**2 + k["k_d"] * d + k["k_dd"] * d**2 + k["k_td"] * t * d + k["c"]
    return kappa / tau**2 * (drift + (k["b_u"] + k["b_t"] * t + k["b_d"] * d) * v)


def flight_of(config: rust.Config, duration: float, **simulator: Any) -> rust.Config:
    """Return the flight with this duration [s] and these settings of its simulator."""
    return {**config, "simulator": {**config["simulator"], "duration": duration, **simulator}}
