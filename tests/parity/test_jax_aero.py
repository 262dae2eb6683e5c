"""JAX aerodynamics against the Rust crate: forces, and where the controller places them."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from jax_aero import rust
from jax_aero.aero import LinksInAir, aero_model
from jax_aero.aero.pchip import interpolate, pchip
from jax_aero.base.typed_config import aero_config
from jax_aero.body.robot import load_robot
from tests.aero_kinds import OF_LINKS

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-10
SPEEDS = (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 10.0, 40.0, 300.0)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([0.0, 1.0, 3.0, 4.0, 6.0], [0.0, 2.0, 1.0, 1.5, 5.0]),
        ([0.0, 1.0, 3.0], [0.0, 0.1, 5.0]),
        ([0, 1, 1.5], [0, 1, -7]),
    ],
    ids=["an extremum", "an end kept to its side", "an end kept within three secants"],
)
def test_interpolation_is_scipys(x, y, measured):
    """On points that are not even, where the weights of the slopes differ; values of order 10, a dozen roundings."""
    at = np.linspace(x[0], x[-1], 50)
    ours = interpolate(pchip(jnp.asarray(x, float), jnp.asarray(y, float)), jnp.asarray(at))
    measured("value", np.abs(ours - PchipInterpolator(x, y)(at)).max(), 3e-14)


@pytest.mark.parametrize("name", OF_LINKS)
def test_forces(name, robot, robot_name, agree):
    """At every speed, also none, and for wind along the axis from both sides."""
    table = rust.load_aero(OF_LINKS[name])
    ours = load_robot(ROOT / "configs" / "robot" / f"{robot_name}.toml")
    if name == "axisymmetric":
        table["coefficients"] = sorted(ours.aero_links.coefficients)[0]
    model = aero_model(aero_config(table), ours)
    rng = np.random.default_rng(11)
    axes = rng.normal(size=(len(SPEEDS), ours.aero_links.count, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    v_air = rng.normal(size=axes.shape) * np.array(SPEEDS)[:, None, None]
    v_air[:, 0], v_air[:, 1] = (axes[:, k] * np.array(SPEEDS)[:, None] * sign for k, sign in ((0, 1.0), (1, -1.0)))
    forces = np.asarray(jax.jit(jax.vmap(lambda a, v: model.forces(LinksInAir(a, v, None, None, None))))(axes, v_air))
    for case in range(len(SPEEDS)):
        agree(f"{name} forces", forces[case], rust.aero_forces(robot, table, axes[case], v_air[case]), TOLERANCE)
