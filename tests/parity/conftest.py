"""Random states of the robots with joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.result import FlightResult
from jax_aero.rust import Robot, State

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


@pytest.fixture(scope="module")
def fly_with_last_bits() -> Callable[..., list[tuple[FlightResult, FlightResult, list[FlightResult]]]]:
    """Fly in JAX, as one batch, and in the crate; and there again with some last bits of a thrust changed."""
    from jax_aero import sim

    def nudge(table: rust.Config, bits: int) -> rust.Config:
        simulator = table["simulator"]
        first, *others = simulator["initial"]["thrust"]
        initial = simulator["initial"] | {"thrust": [first * (1.0 + bits * np.finfo(float).eps), *others]}
        return table | {"simulator": simulator | {"initial": initial}}

    def fly(
        tables: list[rust.Config], bits: tuple[int, ...]
    ) -> list[tuple[FlightResult, FlightResult, list[FlightResult]]]:
        changed = [[rust.fly(nudge(table, some)) for some in bits] for table in tables]
        return list(zip(sim.fly_batch(tables, full_log=True), map(rust.fly, tables), changed, strict=True))

    return fly
