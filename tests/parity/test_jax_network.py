"""Networks in JAX against the Rust crate: forces of every kind of network, and whole flights with one."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import LinkConventions, aero_model, link_forces
from jax_aero.aero.network import init_network
from jax_aero.aero.network_card import save_network
from jax_aero.base.typed_config import aero_config
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import load_robot
from jax_aero.types import State
from jax_aero.verify import random_states

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "configs" / "robot" / "ironcub_mk1.toml"
TOLERANCE = {"f32": 1e-6, "f64": 1e-12}
"""On the forces of all links, relative to the greatest."""
STATES = 30

ALL = ("wind", "joints", "link_wind", "link_position", "link_shadow")
SHAPES = {
    "paper": {"hidden": (64, 64, 64)},
    "linear": {"hidden": ()},
    "torso alone": {"hidden": (9,), "joints": (0, 1, 2), "mirror": True},
    "symmetric": {"hidden": (33,), "activation": "tanh", "members": 3, "mirror": True},
    "base axes": {"hidden": (20, 70), "mirror": True},
    "base axes by link": {
        "hidden": (17,),
        "blocks": ALL,
        "layout": "link",
        "mirror": True,
        "members": 2,
        "activation": "silu",
    },
    "compact": {
        "hidden": (128, 128),
        "blocks": ("link_wind", "link_position", "link_shadow"),
        "activation": "silu",
        "frame": "link",
        "layout": "link",
        "mirror": True,
    },
}


@pytest.fixture(scope="module")
def ours():
    return load_robot(ROBOT)


@pytest.mark.close_to_tolerance("sums of up to 256 products in single precision, whose rounding is 6e-8 each")
@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("name", SHAPES)
def test_forces(name, precision, ours, tmp_path, measured):
    """Anywhere, moving, in any wind and in none."""
    theirs = rust.Robot(ROBOT)
    baseline = ours.aero_links.coefficients["signed"] if name in ("tunnel axes", "compact") else None
    network = init_network(jax.random.key(5), ours, baseline=baseline, **SHAPES[name])
    card = tmp_path / "random.json"
    save_network(card, network, ours, description="Random.", training={})
    table = {"model": "network", "card": str(card), "precision": precision, "air_density": 1.225}
    model = aero_model(aero_config(table), ours)
    rng = np.random.default_rng(7)
    states = list(random_states(rng, np.array(theirs.joint_limits), STATES))
    winds = rng.normal(size=(STATES, 3)) * 10.0
    winds[0] = np.asarray(states[0].velocity)[:3]  # moving with the air: still

    @jax.jit
    def forces_of(state, wind):
        return link_forces(model, ours, kinematics(ours, state), LinkConventions(), wind).forces

    worst = 0.0
    for state, wind in zip(states, winds, strict=True):
        expected = rust.link_forces(theirs, table, state, wind)
        found = np.asarray(forces_of(State(*(jnp.asarray(x) for x in state)), jnp.asarray(wind)))
        assert np.isfinite(found).all()
        worst = max(worst, np.abs(found - expected).max() / max(np.abs(expected).max(), 1e-12))
    measured(f"network {name}, {precision}: forces", worst, TOLERANCE[precision])
    assert not np.any(rust.link_forces(theirs, table, states[0], winds[0]))


def test_the_function_for_single_links_refuses_a_network(ours):
    table = rust.load_config("test4")["simulator"]["aero"]
    axes = np.tile([0.0, 0.0, 1.0], (ours.aero_links.count, 1))
    with pytest.raises(ValueError, match=r"aero\.model is network"):
        rust.aero_forces(rust.Robot(ROBOT), table, axes, axes)
