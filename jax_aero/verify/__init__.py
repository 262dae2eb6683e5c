"""Comparison of the Rust crate with JAX: on random states, and along a flight (`jax_aero.verify.flight`).

A difference is compared with the greatest entry of the crate's results. A quantity that vanishes, as a sum of terms
that cancel, consists of rounding only: a difference may be as large as that rounding, which is measured as the change
of the crate's result when every input changes by one rounding. `jax_aero.commands.verify` is the command line.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from jax_aero import rust
from jax_aero.base import places

KERNEL_TOLERANCE = 1e-10
QP_TOLERANCE = 1e-8

UNOPTIMISED = {"xla_backend_optimization_level": 0}
"""Options for `jax.jit` of what runs for a moment: to compile it takes longer."""

ROUNDINGS = 30.0
"""Factor by which two orders of computation may differ more than by one rounding of every input; 4 is usual."""

LEAST_SCALE = 1e-3
"""Greatest entry, in its unit, below which a quantity is the difference of greater ones, and counts as this large."""

SOLUTIONS = {
    "thrust_rate", "joint_velocity_command", "joint_acceleration_desired", "unlimited_torque", "joint_torque",
}  # fmt: skip
"""Quantities that are solutions of a QP or follow from one."""

OF_SOLVERS = ("plan_kept", "plan_missing", "momentum_held", "torque_held")
"""Degraded modes that JAX has as well."""


@dataclass(frozen=True)
class Row:
    """Comparison of one quantity over all samples."""

    group: str
    quantity: str
    tolerance: float
    is_relative: bool
    """Whether the tolerance is on the relative error."""
    absolute: float
    """Greatest difference."""
    scale: float
    """Greatest entry of the crate's results over all samples, since in one sample it may be a small difference."""
    rounding: float
    """Greatest change of the crate's results when every input changes by one rounding."""
    agrees: bool
    """Whether every difference is within the tolerance, or within rounding; false for NaN."""
    samples: int
    """Number of states or ticks."""

    @property
    def relative(self) -> float:
        """Greatest difference divided by the greatest entry."""
        return self.absolute / self.scale if self.scale > 0.0 else self.absolute


def compare(
    group: str,
    quantity: str,
    ours: ArrayLike,
    theirs: ArrayLike,
    tolerance: float,
    *,
    rounded: ArrayLike | None = None,
    relative: bool = True,
    carried: int | None = None,
) -> Row:
    """Compare samples, along the first axis; `rounded` are theirs with inputs changed by a rounding.

    A sample may differ by the greatest rounding of the `carried` samples before and after it, or of all.
    """
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    apart, scale = differences(ours, theirs), float(np.max(np.abs(np.nan_to_num(theirs)), initial=0.0))
    rounding = np.zeros_like(apart) if rounded is None else differences(rounded, theirs)
    reach = rounding.size if carried is None else carried
    near = sliding_window_view(np.pad(rounding, reach), 2 * reach + 1).max(axis=1)
    allowed = np.maximum(tolerance * (max(scale, LEAST_SCALE) if relative else 1.0), ROUNDINGS * near)
    greatest, agrees = float(np.max(apart, initial=0.0)), bool(np.all(apart <= allowed))
    rounding_max = float(np.max(rounding, initial=0.0))
    return Row(group, quantity, tolerance, relative, greatest, scale, rounding_max, agrees, len(theirs))


def merge(rows: Iterable[Row]) -> list[Row]:
    """Return the worst row of each quantity, with the samples of all."""
    of: dict[str, list[Row]] = {}
    for row in rows:
        of.setdefault(row.quantity, []).append(row)
    worst = (max(alike, key=lambda row: (not row.agrees, row.relative)) for alike in of.values())
    return [replace(row, samples=sum(each.samples for each in of[row.quantity])) for row in worst]


def differences(ours: ArrayLike, theirs: ArrayLike) -> NDArray[np.float64]:
    """Return the greatest difference in every sample (n, ...); what is unknown in both is equal."""
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    apart = np.where(np.isnan(ours) & np.isnan(theirs), 0.0, np.abs(ours - theirs))
    return np.asarray(np.max(apart.reshape(len(apart), -1), axis=1, initial=0.0))


# --- samples and comparisons --------------------------------------------------------------------------------------


def verify_robots(robot_path: str, n_states: int, backend: Any = "tree", seed: int = 0) -> list[Row]:
    """Compare kinematics and dynamics of a robot, and of a small one that has joints of both kinds."""
    slider = str(places.find("robot", "slider"))
    both = {"dynamics": robot_path, "slider": slider}
    return [row for group, path in both.items() for row in verify_robot(path, n_states, backend, seed, group)]


def verify_robot(
    robot_path: str, n_states: int, backend: Any = "tree", seed: int = 0, group: str = "dynamics"
) -> list[Row]:
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

    @partial(jax.jit, compiler_options=UNOPTIMISED)
    @jax.vmap
    def evaluate(state: State) -> Any:
        kin = kinematics(robot, state)
        dyn = dynamics(robot, state, kin, backend)
        return kin, dyn, forward_dynamics(dyn, jnp.cos(state.velocity))

    batch = State(*(jnp.stack([jnp.asarray(value) for value in field]) for field in zip(*states, strict=True)))
    kin, dyn, accelerations = jax.device_get(evaluate(batch))
    ours = {"body_positions": kin.body_positions, "body_rotations": kin.body_rotations, "com_position": kin.com}
    ours |= dyn._asdict() | {"acceleration": accelerations}
    theirs, near = [crate(state) for state in states], [crate(round_state(rng, state)) for state in states]

    def compare_all(name: str) -> Row:
        expected, rounded = ([tick[name] for tick in ticks] for ticks in (theirs, near))
        return compare(group, name, ours[name], expected, KERNEL_TOLERANCE, rounded=rounded)

    return [compare_all(name) for name in ours]


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
    rounded = rust.State(*(round_numbers(rng, value) for value in state))
    return rounded._replace(base_rotation=round_rotation(rng, state.base_rotation))


def round_sample(rng: np.random.Generator, sample: Sample) -> Sample:
    """Return a sample whose every number differs by one rounding."""
    followed = {name: round_numbers(rng, value) for name, value in vars(sample.setpoint).items()}
    followed["rotation"] = round_rotation(rng, sample.setpoint.rotation)
    posture, inertia, integral = (round_numbers(rng, part) for part in sample.memory)
    return Sample(
        round_state(rng, sample.state),
        round_numbers(rng, sample.thrust),
        round_numbers(rng, sample.wind),
        rust.Setpoint(**followed),
        (posture, inertia, integral),
    )


def round_numbers(rng: np.random.Generator, value: ArrayLike) -> NDArray[np.float64]:
    """Return numbers, each changed by one rounding."""
    value = np.asarray(value, np.float64)
    return np.asarray(value * (1.0 + np.spacing(1.0) * rng.choice([-1.0, 1.0], value.shape)))


def round_rotation(rng: np.random.Generator, rotation: ArrayLike) -> NDArray[np.float64]:
    """Return rotations (..., 3, 3), each turned by one rounding about every axis."""
    rotation = np.asarray(rotation)
    turn = 0.5 * np.spacing(1.0) * rng.choice([-1.0, 1.0], (*rotation.shape[:-2], 3))
    wxyz = np.concatenate([np.ones_like(turn[..., :1]), turn], axis=-1)
    return np.asarray(rotation @ rust.rotation_from_wxyz(wxyz))


def random_samples(config: Mapping[str, Any], count: int, seed: int = 0) -> list[Sample]:
    """Return ticks unlike any flight: thrusts beyond their limits, strong wind, distant set-points and postures.

    Some integrals are as large as they get.
    """
    from jax_aero.control.law.torques import INTEGRAL_LIMIT

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
        posture = np.asarray(state.joint_position) + 0.2 * rng.normal(size=n_joints)
        integral = 0.05 * rng.normal(size=n_joints)
        integral[rng.random(n_joints) < 0.2] = rng.choice([-INTEGRAL_LIMIT, INTEGRAL_LIMIT])
        memory = (posture, inertia, integral)
        thrust, wind = rng.uniform(-0.1, 1.1, n_jets) * robot.thrust_max, rng.normal(scale=8.0, size=3)
        samples.append(Sample(state, thrust, wind, followed, memory))
    return samples


def compared(config: Mapping[str, Any]) -> Literal["tick", "law", "nothing"]:
    """Return what of a flight JAX computes: every "tick", the "law" alone, or "nothing" of its controller."""
    from jax_aero.base.typed_config import scenario_config
    from jax_aero.refusals import refused

    typed = scenario_config(config)
    if not refused(typed):
        return "tick"
    return "law" if not refused(typed, of_law=True) and typed.controller.torque.steps == 1 else "nothing"


def use_double_precision(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration with networks in double precision, since in single both would round differently."""
    for part in ("simulator", "controller"):
        if config[part]["aero"]["model"] == "network":
            config[part]["aero"]["precision"] = "f64"
    return config
