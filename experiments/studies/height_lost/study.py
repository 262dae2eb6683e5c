"""Least height that a hovering robot loses after one of its engines stops, by optimal control, beside flights.

`jax-aero study height_lost` begins with the state of a robot's flight when an engine stops. For a while nothing reacts.
Then the throttles of the others (M32) and joints of limited velocity are free, in the centroidal dynamics. The fall
ends in a state in which the robot may touch down and go on: slow and level, without turning, moments balanced, and no
longer falling faster. Each is a local optimum, and a flight may touch down before it is at rest. Engines that are
faster or stronger show what either is worth. The result goes to `results/height_lost/hover/`.
"""

from __future__ import annotations

from itertools import product
from typing import Annotated, Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from experiments.robot.groups import joints_of
from experiments.study import Findings, Study
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.spatial import turn_from_rpy
from jax_aero.symbolic.trajectory import IPOPT, CentroidalFlight

Array = NDArray[np.float64]

HEIGHT, DOWNWARDS, TURN = 2, 5, slice(6, 9)
"""Entries of the state of a `CentroidalFlight`."""
EFFORT = 1e-3
"""Weight of squared joint velocities, relative to their limit, over time [m/s]: it selects one of equal falls. Ours."""
ABOVE = 30.0
"""Height that is added to the flights [m]."""
GROUPS = ("torso", "left_arm", "right_arm")
"""Joint groups that move."""
JOINT_VELOCITY_MAX = np.radians(150.0)
"""As in the recommended controller's descent [rad/s]."""
DOWNWARDS_MAX, SIDEWAYS_MAX, LEAN_MAX = 1.5, 1.0, np.radians(30.0)
"""Limits of a landing, as in the simulator [m/s, m/s, rad]."""


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

    def __post_init__(self) -> None:
        tables.check_levels(self, "experiments", "engines", "others")


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


UNITS = dict(zip(Landing._fields, ("m", "s", "m s-1", "deg"), strict=True))


class Fall:
    """The fall of one robot without one engine.

        X = (x, Ṫ), x of `CentroidalFlight`;  U = (v(u), ṡ);  T̈ = κ/τ² (f + g v)(T/κ, τ Ṫ/κ)        M32

    with engines whose thrust is κ times, and whose time τ times theirs. States are continuous, inputs linear on every
    interval, and the dynamics hold by the trapezoidal rule.
    """

    def __init__(self, asked: HeightLost, config: rust.Config, engine: str) -> None:
        self.asked, robot = asked, load_robot(config["robot"])
        log = rust.fly(_with(config, asked.time)).log
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
        self.height = float(self.start[HEIGHT])
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
        self._build(len(jets))

    def _end(self, x: Any, x_dot: Any) -> tuple[Any, Array, Array]:
        """Return rows that hold at the end of a fall, and their limits: level, slow, steady, balanced."""
        rows = ca.vertcat(self.upright(x), ca.sumsqr(x[3:5]), x_dot[DOWNWARDS], x_dot[TURN], x_dot[9:12])
        lower = [np.cos(LEAN_MAX), 0.0, 0.0, *[0.0] * 6]
        return rows, np.array(lower), np.array([np.inf, SIDEWAYS_MAX**2, np.inf, *[0.0] * 6])

    def _build(self, jets: int) -> None:
        """Build the fall, and the search for the state in which the robot is accelerated upwards most."""
        count = self.asked.intervals
        x, u = ca.MX.sym("x", self.size, count + 1), ca.MX.sym("u", self.inputs[0].size, count + 1)
        scales, duration = ca.MX.sym("p", 2), ca.MX.sym("duration")
        x_dot, h = self.f.map(count + 1)(x, u, ca.repmat(scales, 1, count + 1)), duration / count
        defects = ca.vec(x[:, 1:] - x[:, :-1] - 0.5 * h * (x_dot[:, 1:] + x_dot[:, :-1]))
        end, lower, upper = self._end(x[:, -1], x_dot[:, -1])
        cost = self.height - x[HEIGHT, -1] + EFFORT * h * ca.sumsqr(u[jets:, :] / JOINT_VELOCITY_MAX)
        problem = {"x": ca.veccat(x, u, duration), "p": scales, "f": cost, "g": ca.vertcat(defects, end)}
        none = np.zeros(defects.numel())
        self.rows = {"lbg": np.concatenate([none, lower]), "ubg": np.concatenate([none, upper])}
        self.solver = ca.nlpsol("fall", "ipopt", problem, IPOPT)
        alone = ca.MX.sym("xu", self.size + self.inputs[0].size)
        x_dot = self.f(alone[: self.size], alone[self.size :], scales)
        rows, lower, upper = self._end(alone[: self.size], x_dot)
        lower[2] = -np.inf
        self.end_rows = {"lbg": lower, "ubg": upper}
        self.best = ca.nlpsol("best", "ipopt", {"x": alone, "p": scales, "f": -x_dot[DOWNWARDS], "g": rows}, IPOPT)

    def greatest_acceleration(self, thrust: float) -> float:
        """Return the greatest acceleration upwards in a state in which the fall may end [m/s²]."""
        (_, last), inputs = self._bounds(thrust), np.array(self.still)
        guess = np.concatenate([np.clip(self.start, *last), inputs.mean(axis=0)])
        bounds = [np.concatenate(pair) for pair in zip(last, inputs, strict=True)]
        answer = self.best(x0=guess, p=[1.0, thrust], lbx=bounds[0], ubx=bounds[1], **self.end_rows)
        return -float(answer["f"]) if self.best.stats()["success"] else np.nan

    def _bounds(self, thrust: float) -> list[tuple[Array, Array]]:
        """Return the bounds of the states on the way and at the end: a fall does not climb again."""
        high, low = self.upper.copy(), self.lower.copy()
        high[self.thrust] *= thrust
        high[DOWNWARDS] = 0.0
        low[DOWNWARDS] = -DOWNWARDS_MAX
        return [(self.lower, high), (low, high)]

    def solve(self, spool_up: float, thrust: float, guess: Array | None = None) -> tuple[Landing, Array | None]:
        """Return the highest landing and the unknowns, `None` if there is none; `guess` are those of another one."""
        count, (way, last) = self.asked.intervals, self._bounds(thrust)
        if not self.greatest_acceleration(thrust) >= 0.0:
            return Landing(), None
        lower, upper = (
            np.concatenate([self.start, *[on] * (count - 1), end, *[u] * count, still, [duration]])
            for on, end, u, still, duration in zip(way, last, self.inputs, self.still, (0.1, 6.0), strict=True)
        )
        if guess is None:
            path = np.tile(self.start, (count + 1, 1))
            path[:, self.thrust] += np.linspace(0.0, 0.8, count + 1)[:, None] * (way[1] - self.start)[self.thrust]
            inputs = np.tile(np.mean(self.inputs, axis=0), count + 1)
            guess = np.concatenate([path.ravel(), inputs, [1.5]])
        answer = self.solver(x0=guess, p=[spool_up, thrust], lbx=lower, ubx=upper, **self.rows)
        if not self.solver.stats()["success"]:
            return Landing(), None
        found = np.array(answer["x"].full())[:, 0]
        path = found[: self.size * (count + 1)].reshape(count + 1, self.size)
        lean = np.degrees(np.arccos(self.upright.map(count + 1)(path.T).full().min()))
        height, duration = self.height - path[-1, HEIGHT], found[-1] + self.asked.reaction
        return Landing(float(height), float(duration), float(-path[:, DOWNWARDS].min()), float(lean)), found


def _input(engine: dict[str, float], throttle: float) -> float:
    """Return v(u)."""
    return throttle * (1.0 + engine["b_uu"] * throttle)


def _acceleration(k: dict[str, float], thrust: Any, rate: Any, v: Any, scales: Any) -> Any:
    """Return T̈ of an engine κ times as strong that takes τ times as long."""
    tau, kappa = ca.vertsplit(scales)
    t, d = thrust / kappa, rate * tau / kappa
    drift = k["k_t"] * t + k["k_tt"] * t**2 + k["k_d"] * d + k["k_dd"] * d**2 + k["k_td"] * t * d + k["c"]
    return kappa / tau**2 * (drift + (k["b_u"] + k["b_t"] * t + k["b_d"] * d) * v)


def _with(config: rust.Config, duration: float, **simulator: Any) -> rust.Config:
    return {**config, "simulator": {**config["simulator"], "duration": duration, **simulator}}


def flown(asked: HeightLost, config: rust.Config, engine: str) -> Landing:
    """Return the end of a flight's fall: within the limits of a landing from then on, for 10 s after the loss."""
    initial = config["simulator"]["initial"]
    x, y, z = initial["base_position"]
    fault = {"jets": {"failure": {"jet": engine, "time": asked.time, "kind": "off"}}}
    higher = _with(config, asked.time + 10.0, initial={**initial, "base_position": [x, y, z + ABOVE]})
    log = rust.fly({**higher, "disturbances": fault}).log
    after = log["time"] >= asked.time
    velocity = log["com_velocity"][after]
    up = Rotation.from_quat(np.roll(log["base_quaternion"][after], -1, axis=1)).as_matrix()[:, 2, 2]
    lean = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
    sideways = np.linalg.norm(velocity[:, :2], axis=1)
    beyond = (-velocity[:, 2] > DOWNWARDS_MAX) | (sideways > SIDEWAYS_MAX) | (lean > np.degrees(LEAN_MAX))
    last = int(np.flatnonzero(beyond)[-1]) if beyond.any() else 0
    if last + 1 >= beyond.size:
        return Landing()
    height, time = log["com_position"][after][:, 2], log["time"][after]
    return Landing(height[0] - height[last], time[last] - time[0], -velocity[:, 2].min(), lean.max())


def compute(_: str, asked: HeightLost) -> Findings:
    """Compute all falls, those with other engines from the first, and fly."""
    flights = {name: rust.load_config(name) for name in asked.experiments}
    rows: list[list[Landing]] = []
    best: list[float] = []
    for config, engine in product(flights.values(), asked.engines):
        fall, guess = Fall(asked, config, engine), None
        best.append(fall.greatest_acceleration(1.0))
        rows.append([])
        for scales in asked.others:
            landing, found = fall.solve(*scales, guess)
            guess = found if guess is None else guess
            rows[-1].append(landing)
        rows[-1].append(flown(asked, config, engine))
    dims, shape = ("robot", "engine"), (len(flights), len(asked.engines))
    values = np.array(rows).reshape(*shape, len(asked.others) + 1, len(Landing._fields))
    variables: dict[str, Any] = {"acceleration": (dims, np.reshape(best, shape), {"units": "m s-2"})}
    for place, (field, unit) in enumerate(UNITS.items()):
        variables[field] = ((*dims, "others"), values[:, :, :-1, place], {"units": unit})
        variables[f"flown_{field}"] = (dims, values[:, :, -1, place], {"units": unit})
    for place, name in enumerate(("spool_up", "thrust")):
        variables[name] = ("others", [scales[place] for scales in asked.others], {"units": "1"})
    data = xr.Dataset(variables, {"robot": list(flights), "engine": list(asked.engines)})
    return Findings("Least height lost after an engine stops", data, _summary(data), flights=flights)


def _summary(data: xr.Dataset) -> dict[str, float | None]:
    found: dict[str, float] = {}
    for robot, engine in product(data["robot"].values, data["engine"].values):
        name, one = f"{robot}, {engine}", data.sel(robot=robot, engine=engine)
        found[f"{name}: greatest acceleration at the end [m/s2]"] = float(one["acceleration"])
        for field, unit in UNITS.items():
            for of in one["others"].values:
                scales = f"spool-up {float(one['spool_up'][of]):g}, thrust {float(one['thrust'][of]):g}"
                found[f"{name}, {scales}: {field} [{unit}]"] = float(one[field][of])
            found[f"{name}, flown: {field} [{unit}]"] = float(one[f"flown_{field}"])
    return {key: None if np.isnan(value) else value for key, value in found.items()}


STUDY = Study("height_lost", __doc__, HeightLost, compute, ("hover",))
main = STUDY.main
