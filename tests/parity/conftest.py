"""Random states of the robots with joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.result import FlightResult
from jax_aero.rust import Robot, State

if TYPE_CHECKING:
    from jax_aero.control.measurement import Reading

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ("ironcub_mk1", "ironcub_mk3", "sparrow", "slider")


@pytest.fixture(params=ROBOTS)
def robot_name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def robot(robot_name: str) -> Robot:
    return Robot(ROOT / "configs" / "robot" / f"{robot_name}.toml")


@pytest.fixture
def urdf(robot_name: str) -> Path:
    return ROOT / "configs" / "robot" / f"{robot_name}.urdf"


@pytest.fixture
def random_states(robot: Robot) -> Iterator[tuple[State, NDArray[np.float64]]]:
    """200 states, base anywhere, joints within their limits and beyond, fast; with the base's quaternion wxyz."""
    rng = np.random.default_rng(20260101)
    limits = np.array(robot.joint_limits)
    middle, half = limits.mean(axis=1), np.ptp(limits, axis=1) / 2
    half = np.where(np.isfinite(half), half, np.pi)
    n = len(limits)

    def draw(index: int) -> tuple[State, NDArray[np.float64]]:
        wxyz = rng.normal(size=4)
        wxyz /= np.linalg.norm(wxyz)
        reach = 1.0 if index % 2 else 2.5
        joints = middle + reach * half * rng.uniform(-1, 1, n)
        velocity = np.concatenate(
            [rng.normal(scale=3, size=3), rng.normal(scale=4, size=3), rng.normal(scale=5, size=n)]
        )
        return State(rng.normal(scale=10, size=3), rust.rotation_from_wxyz(wxyz), joints, velocity), wxyz

    return map(draw, range(200))


@pytest.fixture
def agree_with_the_log(measured: Callable[..., None]) -> Callable[[Reading, FlightResult, float, str], None]:
    """Hold readings of every tick in JAX to those that the log of a flight of the crate has."""

    def compare(found: Reading, flown: FlightResult, tolerance: float, because: str) -> None:
        rotation = rust.rotation_from_wxyz(flown["measured_base_quaternion"])
        for name, ours, theirs in (
            ("measured_base_position", found.state.base_position, flown["measured_base_position"]),
            ("measured_base_quaternion", found.state.base_rotation, rotation),
            ("measured_base_velocity", found.state.velocity[:, :6], flown["measured_base_velocity"]),
            ("measured_joint_velocity", found.state.velocity[:, 6:], flown["measured_joint_velocity"]),
            ("measured_thrust", found.thrust, flown["measured_thrust"]),
        ):
            measured(name, np.max(np.abs(ours - theirs)), tolerance, because=because)

    return compare


@pytest.fixture
def agree_with_dynamics(
    robot: Robot, random_states: Iterator[tuple[State, NDArray[np.float64]]], agree: Callable[..., None]
) -> Callable[[Any, float], None]:
    """Hold dynamics and forward dynamics of a robot to those of an oracle, in many states."""

    def compare(oracle: Any, tolerance: float) -> None:
        rng = np.random.default_rng(7)
        n = 6 + len(robot.joint_names)
        for state, wxyz in random_states:
            oracle.set(state, wxyz)
            ours, theirs = rust.dynamics(robot, state), oracle.kinematics()
            agree("body positions", ours.body_positions, theirs["body_positions"], tolerance)
            agree("body rotations", ours.body_rotations, theirs["body_rotations"], tolerance)
            agree("CoM", ours.com_position, theirs["com_position"], tolerance)
            agree("momentum matrix, linear", ours.momentum_matrix[:3], theirs["momentum_matrix"][:3], tolerance)
            agree("momentum matrix, angular", ours.momentum_matrix[3:], theirs["momentum_matrix"][3:], tolerance)
            agree("momentum, linear", ours.momentum[:3], theirs["momentum"][:3], tolerance)
            agree("momentum, angular", ours.momentum[3:], theirs["momentum"][3:], tolerance)
            agree("centroidal inertia", ours.centroidal_inertia, theirs["centroidal_inertia"], tolerance)

            # In units of √(M_ii M_jj): small inertias of wrists count as much as the mass of the robot.
            mass_matrix, bias = oracle.mass_matrix(), oracle.bias()
            unit = 1 / np.sqrt(np.diag(mass_matrix))
            scale = np.outer(unit, unit)
            agree("mass matrix, every entry scaled", ours.mass_matrix * scale, mass_matrix * scale, tolerance)
            for name, rows in (("force", slice(3)), ("moment", slice(3, 6)), ("joints", slice(6, None))):
                agree(f"bias, {name}", ours.bias[rows], bias[rows], tolerance)

            force = rng.normal(size=n) * np.where(np.arange(n) < 6, 200, 20)
            acceleration = rust.forward_dynamics(robot, state, force)
            agree("acceleration", acceleration, oracle.forward_dynamics(force), tolerance)

    return compare
