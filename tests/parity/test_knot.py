"""The crate's expansions of a knot are those of JAX's derivatives: `rust/core/tests/nonlinear.rs` reads the numbers.

They are stored in `tests/golden/knots.toml`; `UPDATE=1` before this test writes them anew.
"""

from __future__ import annotations

import os
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from tests.parity.knot import Knot, World

pytestmark = pytest.mark.usefixtures("x64")

STORED = Path(__file__).parents[1] / "golden" / "knots.toml"
DIRECTIONS = 3
"""Each expansion is stored times cos(1 … w), cos(2 … 2 w) and cos(3 … 3 w), in which every entry shows."""


DURATIONS = (0.08, 0.5)
"""Of the motion, and of the cost [s]."""


@cache
def expansion() -> Any:
    """Return the function of posture, wind, state and inputs that expands a knot: compiled once."""
    config = rust.load_config("robot")

    def expand(posture: Any, wind: Any, x: Knot, u: Any) -> Any:
        world = World(config, posture, wind, speed=0.5)
        step, dynamics = world.step(x, u, DURATIONS[0])
        return world.move(x, step), dynamics, *world.cost(x, u, DURATIONS[1])

    return jax.jit(expand)


def case(seed: int, *, beyond: bool) -> dict[str, Any]:
    """Return a random knot with its expansion; `beyond` the limits of thrusts, joints and distances."""
    rng, config = np.random.default_rng(seed), rust.load_config("robot")
    robot = rust.Robot(config["robot"])
    lower, upper = np.array(robot.joint_limits).T
    share = rng.uniform(-0.1, 1.1, lower.size) if beyond else rng.uniform(0.2, 0.8, lower.size)
    posture, wind = lower + rng.uniform(0.2, 0.8, lower.size) * (upper - lower), rng.normal(scale=5.0, size=3)
    at = np.array(World(config, posture, wind, speed=0.5).joints)
    jets = len(robot.jet_names)
    most = (1.2 if beyond else 0.8) * np.array(robot.thrust_max)
    state = {
        "height": rng.normal(),
        "velocity": rng.normal(scale=0.5, size=3),
        "rotation": rust.rotation_from_wxyz(np.array([1.0, *rng.normal(scale=0.4, size=3)])),
        "momentum": rng.normal(scale=2.0, size=3),
        "thrust": rng.uniform(0.2, 1.0, jets) * most,
        "rate": rng.uniform(-20.0, 20.0, jets),
        "joints": (lower + share * (upper - lower))[at],
    }
    inputs = np.concatenate([rng.uniform(0.1, 0.9, jets), rng.uniform(-0.5, 0.5, at.size)])
    x = Knot(*map(jnp.asarray, state.values()))
    moved, dynamics, cost, gradient, hessian = jax.device_get(expansion()(posture, wind, x, inputs))
    directions = np.cos(np.outer(np.arange(1, DIRECTIONS + 1), np.arange(1, dynamics.shape[1] + 1))).T
    found = {"dynamics": (dynamics @ directions).T, "hessian": (hessian @ directions).T}
    found |= {"next": np.concatenate([jnp.ravel(part) for part in moved]), "gradient": gradient}
    given = {"posture": posture, "wind": wind, **state, "inputs": inputs, "durations": np.array(DURATIONS)}
    return {name: np.ravel(np.asarray(value)) for name, value in (given | found).items()} | {"cost": np.array([cost])}


def test_the_stored_expansions_are_those_of_jax():
    cases = [case(seed, beyond=seed > 2) for seed in range(6)]
    if os.environ.get("UPDATE"):
        lines = ["# Expansions of a knot by JAX: `tests/parity/test_knot.py`.", ""]
        for one in cases:
            rows = (f"{name} = [{', '.join(repr(float(number)) for number in row)}]" for name, row in one.items())
            lines += ["[[case]]", *rows, ""]
        STORED.write_text("\n".join(lines), encoding="utf-8")
    stored = tomllib.loads(STORED.read_text(encoding="utf-8"))["case"]
    assert len(stored) == len(cases)
    for one, expected in zip(cases, stored, strict=True):
        assert {*one} == {*expected}
        for name, value in one.items():
            # Sums of 50 products that cancel, in another order of computation.
            np.testing.assert_allclose(value, expected[name], rtol=0, atol=1e-10 * np.abs(value).max(), err_msg=name)
