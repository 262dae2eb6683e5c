"""The JAX floor's door: configurations and robots read, what cannot be refused, and nothing global touched."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from jax_aero import reference
from jax_aero.config import AxisymmetricConfig, flight_config
from jax_aero.robot import ancestors_of, levels_of, load_robot
from jax_aero.types import Static, pytree, with_dtype

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = sorted((ROOT / "configs" / "experiments").glob("*.toml"))
MK1 = ROOT / "configs" / "robot" / "ironcub_mk1.toml"


@pytest.fixture(scope="module")
def table():
    return reference.load_config(ROOT / "configs" / "experiments" / "test2.toml")


def test_numbers_are_leaves_and_names_are_structure(table):
    config = flight_config(table)
    assert config.simulator.n_ticks == 5000
    assert isinstance(config.controller.aero, AxisymmetricConfig)
    assert all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(config))
    other = flight_config(table | {"controller": table["controller"] | {"lever_arm": "unrotated"}})
    assert jax.tree.structure(config) != jax.tree.structure(other)
    assert jax.tree.structure(config) == jax.tree.structure(flight_config(table))


@pytest.mark.parametrize("section", ["", "simulator", "controller", "envelope", "wind"])
def test_an_unknown_key_is_refused_by_name(table, section):
    spoilt = table | {"typo": 1} if not section else table | {section: table[section] | {"typo": 1}}
    with pytest.raises(ValueError, match=f"{section}.typo".lstrip(".")):
        flight_config(spoilt)


def test_a_missing_key_and_an_unknown_kind_are_refused(table):
    with pytest.raises(ValueError, match=r"wind.velocity.* is missing"):
        flight_config(table | {"wind": {"profile": "constant"}})
    with pytest.raises(ValueError, match=r"wind.profile.*storm"):
        flight_config(table | {"wind": {"profile": "storm"}})


def test_a_pytree_splits_its_fields():
    @pytree
    class Mixed:
        name: Static[str]
        value: float

    assert jax.tree.leaves(Mixed("a", 2.0)) == [2.0]
    assert jax.tree.structure(Mixed("a", 2.0)) != jax.tree.structure(Mixed("b", 2.0))


def test_the_tree_of_bodies():
    parent = (-1, 0, 1, 1, 0)
    assert levels_of(parent) == ((0,), (1, 4), (2, 3))
    expected = [[0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1]]
    assert np.array_equal(ancestors_of(parent), np.array(expected, bool))


def test_precision_is_chosen_leaf_by_leaf():
    robot = with_dtype(load_robot(MK1), np.float32)
    assert {leaf.dtype for leaf in jax.tree.leaves(robot)} == {np.dtype(np.float32)}


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('urdf = "ironcub_mk1.urdf"', 'urdf = "ironcub_mk1.urdf"\ntypo = 1', "unknown keys"),
        ('{ name = "torso_pitch", limits_deg', '{ name = "torso_pitsch", limits_deg', "torso_pitsch"),
        ('frame = "head"', 'frame = "hat"', "hat"),
        ('engine = "P220"', 'engine = "P2200"', "P2200"),
        ("axis = [0.0, 0.0, -1.0]", "axis = [0.0, 0.0, -1.5]", "length 1"),
    ],
)
def test_a_robot_that_cannot_be_is_refused(tmp_path, old, new, reason):
    text = MK1.read_text()
    assert old in text
    (tmp_path / "robot.toml").write_text(text.replace(old, new, 1))
    (tmp_path / "ironcub_mk1.urdf").write_text(MK1.with_suffix(".urdf").read_text())
    with pytest.raises(ValueError, match=reason):
        load_robot(tmp_path / "robot.toml")


def run_python(code):
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_importing_the_package_is_light():
    assert (
        run_python("import jax_aero, sys; print('jax' in sys.modules, 'mujoco' in sys.modules)").split()
        == ["False"] * 2
    )


def test_importing_and_flying_change_no_global_setting():
    code = (
        "import jax, json; before = dict(jax.config.values)\n"
        "from jax_aero import reference, sim, verify\n"
        "import jax_aero.control.tick\n"
        "print(jax.config.values == before, jax.numpy.ones(1).dtype)"
    )
    assert run_python(code).split() == ["True", "float32"]
