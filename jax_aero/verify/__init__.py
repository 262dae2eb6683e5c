"""Comparison of the Rust crate with JAX, on the same states and in the same flight.

Kernels are compared relative to the largest entry of the crate's results, flights by the absolute difference of every
logged signal. A quantity that vanishes, as a sum of terms that cancel, consists of rounding only, and a flight
amplifies it, most where encoders have a resolution: a difference may be as large as that rounding, which is measured as
the change of the crate's result when every input, or the start of the flight, changes by one rounding.
`jax_aero.verify.cli` is the command line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jax_aero import rust
from jax_aero.body.rotations import match_branch

KERNEL_TOLERANCE = 1e-10
QP_TOLERANCE = 1e-8
FLIGHT_TOLERANCE = 1e-6

ROUNDINGS = 30.0
"""Factor by which two orders of computation may differ more than by one rounding of every input; 4 is usual."""

TRUSTED_WHEN_LOST = 8.0
"""Time up to which the signals of a lost flight are compared [s], since it is chaotic before its end."""

NEARBY = 3
"""Flights from starts that differ by a rounding."""

ROUNDINGS_OF_A_FLIGHT = 5.0
"""Factor by which two flights may differ more than those; 1.5 is usual."""

SOLUTIONS = {
    "thrust_rate", "joint_velocity_command", "joint_acceleration_desired", "unlimited_torque", "joint_torque",
}  # fmt: skip
"""Quantities that are solutions of a QP or follow from one."""


GUARD_SIGNALS = ("measured_torque_latency", "measured_thrust_latency")
"""Signals that the crate's guard measures, where it is configured, and JAX does not."""


@dataclass
class Row:
    """Greatest difference of one quantity over all samples."""

    group: str
    quantity: str
    tolerance: float
    is_relative: bool
    """Whether the tolerance is on the relative error."""
    absolute: float = 0.0
    """Greatest difference."""
    scale: float = 0.0
    """Greatest entry of the crate's results over all samples, since in one sample it may be a small difference."""
    rounding: float = 0.0
    """Greatest change of the crate's results when every input changes by one rounding."""

    @property
    def relative(self) -> float:
        """Greatest difference divided by the greatest entry."""
        return self.absolute / self.scale if self.scale > 0.0 else self.absolute

    @property
    def agrees(self) -> bool:
        """Whether the difference is within the tolerance, or within rounding; false for NaN."""
        scale, roundings = (self.scale, ROUNDINGS) if self.is_relative else (1.0, ROUNDINGS_OF_A_FLIGHT)
        return bool(self.absolute <= max(self.tolerance * scale, roundings * self.rounding))


class Comparison:
    """Collection of the greatest difference of every quantity."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, str], Row] = {}

    @property
    def rows(self) -> list[Row]:
        """Rows of all quantities, in order of their first comparison."""
        return list(self._rows.values())

    def add(
        self,
        group: str,
        quantity: str,
        ours: ArrayLike,
        theirs: ArrayLike,
        tolerance: float,
        *,
        rounded: ArrayLike | None = None,
        relative: bool = True,
    ) -> None:
        """Record the difference between `ours` and `theirs`; `rounded` is theirs with inputs changed by a rounding."""
        ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
        # What neither knows is equal.
        is_known = ~(np.isnan(ours) & np.isnan(theirs))
        ours, theirs = np.where(is_known, ours, 0.0), np.where(is_known, theirs, 0.0)
        row = self._rows.setdefault((group, quantity), Row(group, quantity, tolerance, relative))
        # `np.maximum` propagates NaN; `max` would drop it.
        row.absolute = float(np.maximum(row.absolute, np.max(np.abs(ours - theirs), initial=0.0)))
        row.scale = max(row.scale, float(np.max(np.abs(theirs), initial=0.0)))
        changed = theirs if rounded is None else np.where(is_known, rounded, 0.0)
        change = np.max(np.abs(changed - theirs), initial=0.0)
        row.rounding = max(row.rounding, float(change))


# --- samples and comparisons --------------------------------------------------------------------------------------


def verify_robot(robot_path: str, n_states: int, comparison: Comparison, backend: Any = "tree", seed: int = 0) -> None:
    """Compare kinematics and dynamics on random states of any robot."""
    import jax
    import jax.numpy as jnp

    from jax_aero.body.dynamics import dynamics, forward_dynamics
    from jax_aero.body.kinematics import kinematics
    from jax_aero.body.robot import load_robot
    from jax_aero.types import State

    crate_robot, robot = rust.Robot(robot_path), load_robot(robot_path)
    rng = np.random.default_rng(seed)
    states = list(random_states(rng, crate_robot.joint_limits, n_states))

    def crate(state: rust.State) -> dict[str, Any]:
        acceleration = rust.forward_dynamics(crate_robot, state, np.cos(np.asarray(state.velocity)))
        return vars(rust.dynamics(crate_robot, state)) | {"acceleration": acceleration}

    @jax.jit
    @jax.vmap
    def evaluate(state: State) -> Any:
        kin = kinematics(robot, state)
        dyn = dynamics(robot, state, kin, backend)
        return kin, dyn, forward_dynamics(dyn, jnp.cos(state.velocity))

    batch = State(*(jnp.stack([jnp.asarray(value) for value in field]) for field in zip(*states, strict=True)))
    kin, dyn, accelerations = jax.device_get(evaluate(batch))
    ours = {"body_positions": kin.body_positions, "body_rotations": kin.body_rotations, "com_position": kin.com}
    ours |= dyn._asdict() | {"acceleration": accelerations}
    for i, state in enumerate(states):
        theirs, nearby = crate(state), crate(round_state(rng, state))
        for name, values in ours.items():
            comparison.add("dynamics", name, values[i], theirs[name], KERNEL_TOLERANCE, rounded=nearby[name])


def verify_ticks(config: Mapping[str, Any], samples: Sequence[Sample], group: str, comparison: Comparison) -> None:
    """Compare every intermediate value of the controller, and its command, on given samples."""
    import jax
    import jax.numpy as jnp

    from jax_aero.base.typed import scenario_config
    from jax_aero.body.robot import load_robot
    from jax_aero.control import tick as control
    from jax_aero.types import Setpoint, State

    typed = scenario_config(config)
    robot = load_robot(typed.robot)
    params = control.momentum_controller(typed, robot)

    @jax.jit
    def evaluate(memory: Any, state: State, thrust: Any, wind: Any, followed: Setpoint) -> Any:
        memory = control.init(params, robot, state)._replace(**memory)
        _, command, terms = control.tick(params, robot, memory, jnp.zeros(()), state, thrust, wind, followed)
        return command, terms

    rng = np.random.default_rng(0)
    for sample in samples:
        theirs, nearby = (_crate_tick(config, near) for near in (sample, round_sample(rng, sample)))
        memory = dict(zip(("posture", "inertia_0", "velocity_error_integral"), sample.memory, strict=True))
        followed = Setpoint(*(jnp.asarray(getattr(sample.setpoint, name)) for name in Setpoint._fields))
        state = State(*(jnp.asarray(value) for value in sample.state))
        command, terms = jax.device_get(evaluate(memory, state, sample.thrust, sample.wind, followed))
        for name, ours in tick_quantities(command, terms).items():
            tolerance = QP_TOLERANCE if name in SOLUTIONS else KERNEL_TOLERANCE
            expected, rounded = (crate_quantity(tick, name) for tick in (theirs, nearby))
            comparison.add(group, name, ours, expected, tolerance, rounded=rounded)


def _crate_tick(config: Mapping[str, Any], sample: Sample) -> rust.Tick:
    controller = rust.Controller(config)
    started = controller.start(sample.state, sample.thrust, sample.wind)
    controller.state = started.with_posture_control(*(np.ascontiguousarray(part) for part in sample.memory))
    return controller.tick(sample.state, sample.thrust, sample.wind, 0.0, sample.setpoint)


def tick_quantities(command: Any, terms: Any) -> dict[str, Any]:
    """Return every value of a tick by its name in `rust.Tick`."""
    link, momentum, attitude = terms.link_forces, terms.momentum, terms.attitude
    shaping, following = terms.momentum_qp, terms.torque_qp
    return {
        "com_position": terms.kinematics.com,
        **terms.dynamics._asdict(),
        "link_axes": link.axes,
        "link_v_air": link.v_air,
        "link_arm_points": link.arm_points,
        "link_jacobian_points": link.jacobian_points,
        "aero_force": link.forces,
        "jet_axes": momentum.jet_axes,
        "jet_points": momentum.jet_points,
        "a_t": momentum.a_t,
        "lambda_t": momentum.lambda_t,
        "lambda_a": momentum.lambda_a,
        "momentum_rate_estimate": momentum.rate_estimate,
        "unmodelled_wrench": momentum.unmodelled_wrench,
        "k_ddot_desired": attitude.k_ddot_desired,
        "sigma": attitude.sigma,
        "task": shaping.task,
        "task_offset": shaping.offset,
        **{f"momentum_qp.{name}": value for name, value in shaping.problem._asdict().items()},
        "thrust_rate": command.thrust_rate,
        "joint_velocity_command": command.joint_velocity,
        "joint_acceleration_desired": following.acceleration_desired,
        "joint_acceleration_free": following.acceleration_free,
        "torque_gain": following.gain,
        **{f"torque_qp.{name}": value for name, value in following.problem._asdict().items()},
        "unlimited_torque": terms.unlimited_torque,
        "joint_torque": command.joint_torque,
    }


def crate_quantity(tick: rust.Tick, name: str) -> Any:
    """Return a quantity of the crate's tick by a name of `tick_quantities`."""
    value: Any = tick
    for part in name.split("."):
        value = getattr(value, part)
    return value


def verify_flight(
    config: Mapping[str, Any], comparison: Comparison, backend: str = "tree"
) -> tuple[rust.FlightResult, rust.FlightResult]:
    """Compare a whole flight, signal by signal and tick by tick; return the results of the crate and of JAX."""
    from jax_aero.sim import fly

    expected = rust.fly(config)
    rng = np.random.default_rng(0)
    nearby = [rust.fly(_round_start(rng, config)) for _ in range(NEARBY)]
    ours = fly({**config, "simulator": {**config["simulator"], "dynamics": backend}})
    latest = TRUSTED_WHEN_LOST if expected.lost_time is not None else np.inf
    trusted = int(np.count_nonzero(expected["time"] <= latest))
    last = min(trusted, *(len(flight["time"]) for flight in (ours, *nearby)))

    def ends_otherwise(flight: rust.FlightResult) -> bool:
        return flight.outcome != expected.outcome or len(flight["time"]) < trusted

    ends_so_too = any(map(ends_otherwise, nearby))
    comparison.add("flight", "outcome", ends_otherwise(ours), 0.0, 0.0, rounded=ends_so_too, relative=False)
    for name, signal in expected.log.items():
        is_of_guard = name in GUARD_SIGNALS and not np.isnan(signal).all()
        if name not in ("qp_iterations", "qp_kkt") and not is_of_guard:  # properties of the solver, not of the solution
            same, *rounded = (match_branch(name, flight[name][:last], signal[:last]) for flight in (ours, *nearby))
            for one in rounded:
                comparison.add("flight", name, same, signal[:last], FLIGHT_TOLERANCE, rounded=one, relative=False)
    return expected, ours


# --- samples -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sample:
    """Measurement and set-point of a tick; posture, initial inertia and integral of the state before it."""

    state: rust.State
    thrust: NDArray[np.float64]
    wind: NDArray[np.float64]
    setpoint: rust.Setpoint
    memory: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def random_states(rng: np.random.Generator, limits: ArrayLike, count: int) -> Iterator[rust.State]:
    """Yield states with random base poses, high velocities, and joints within their limits, (n, 2)."""
    limits = np.reshape(limits, (-1, 2))
    for _ in range(count):
        wxyz = rng.normal(size=4)
        joints = rng.uniform(limits[:, 0], limits[:, 1])
        velocity = np.concatenate([rng.normal(scale=2.0, size=6), rng.normal(scale=1.0, size=len(limits))])
        yield rust.State(rng.normal(scale=5.0, size=3), rust.rotation_from_wxyz(wxyz), joints, velocity)


def round_state(rng: np.random.Generator, state: rust.State) -> rust.State:
    """Return a state whose every number differs by one rounding."""
    rounded = rust.State(*(_round(rng, value) for value in state))
    return rounded._replace(base_rotation=_round_rotation(rng, state.base_rotation))


def round_sample(rng: np.random.Generator, sample: Sample) -> Sample:
    """Return a sample whose every number differs by one rounding."""
    followed = {name: _round(rng, value) for name, value in vars(sample.setpoint).items()}
    followed["rotation"] = _round_rotation(rng, sample.setpoint.rotation)
    posture, inertia, integral = (_round(rng, part) for part in sample.memory)
    return Sample(
        round_state(rng, sample.state),
        _round(rng, sample.thrust),
        _round(rng, sample.wind),
        rust.Setpoint(**followed),
        (posture, inertia, integral),
    )


def _round(rng: np.random.Generator, value: ArrayLike) -> NDArray[np.float64]:
    value = np.asarray(value, np.float64)
    return np.asarray(value * (1.0 + np.spacing(1.0) * rng.choice([-1.0, 1.0], value.shape)))


def _round_start(rng: np.random.Generator, config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the flight with an initial velocity that moves a place of one metre by a rounding in a tick."""
    velocity = np.asarray(config["simulator"]["initial"]["base_velocity"])
    moved = velocity + np.spacing(1.0) / config["simulator"]["time_step"] * rng.choice([-1.0, 1.0], velocity.shape)
    return rust.set_keys(config, {"simulator.initial.base_velocity": moved.tolist()})


def _round_rotation(rng: np.random.Generator, rotation: ArrayLike) -> NDArray[np.float64]:
    """Return a rotation turned by one rounding about every axis."""
    turn = np.concatenate([[1.0], 0.5 * np.spacing(1.0) * rng.choice([-1.0, 1.0], 3)])
    return np.asarray(np.asarray(rotation) @ rust.rotation_from_wxyz(turn))


def random_samples(config: Mapping[str, Any], count: int, seed: int = 0) -> list[Sample]:
    """Return ticks unlike any flight: thrusts up to their limits, strong wind, distant set-points."""
    rng, robot = np.random.default_rng(seed), rust.Robot(config["robot"])
    n_joints, n_jets = len(robot.joint_names), len(robot.jet_names)
    samples = []
    for state in random_states(rng, robot.joint_limits, count):
        vectors = [rng.normal(size=3) for _ in range(7)]
        com = np.asarray(state.base_position) + 0.3 * vectors[0]
        turned = np.asarray(state.base_rotation) @ rust.rotation_from_wxyz(np.array([1.0, *(0.2 * rng.normal(size=3))]))
        turning = [0.5 * vector for vector in vectors[4:7]]
        followed = rust.Setpoint(com, vectors[1], vectors[2], vectors[3], turned, *turning)
        inertia = np.diag(rng.uniform(0.5, 4.0, 3))
        memory = (np.asarray(state.joint_position), inertia, 0.05 * rng.normal(size=n_joints))
        thrust, wind = rng.uniform(10.0, 150.0, n_jets), rng.normal(scale=8.0, size=3)
        samples.append(Sample(state, thrust, wind, followed, memory))
    return samples


def recorded_samples(config: Mapping[str, Any], flight: rust.FlightResult, count: int) -> list[Sample]:
    """Return evenly spaced ticks of a recorded flight, with its state and set-point but an integral of zero."""
    robot, log = rust.Robot(config["robot"]), flight.log

    def state_at(tick: int) -> rust.State:
        velocity = np.concatenate([log["base_velocity"][tick], log["joint_velocity"][tick]])
        rotation = rust.rotation_from_wxyz(log["base_quaternion"][tick])
        return rust.State(log["base_position"][tick], rotation, log["joint_position"][tick], velocity)

    first = state_at(0)
    rotation = np.asarray(first.base_rotation)
    inertia = rotation.T @ rust.dynamics(robot, first).centroidal_inertia @ rotation
    followed = rust.setpoint_trajectory(config, log["com_position"][0], rotation)
    names = [name for name in rust.Setpoint.__annotations__ if name in followed]
    samples = []
    for tick in np.linspace(0, len(log["time"]) - 1, count, dtype=int):
        target = rust.Setpoint(**{name: followed[name][tick] for name in names})
        memory = (flight.joint_setpoint, inertia, np.zeros(len(robot.joint_names)))
        samples.append(Sample(state_at(tick), log["thrust"][tick], log["wind"][tick], target, memory))
    return samples


def use_double_precision(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration with networks in double precision, since in single both would round differently."""
    for part in ("simulator", "controller"):
        if config[part]["aero"]["model"] == "network":
            config[part]["aero"]["precision"] = "f64"
    return config
