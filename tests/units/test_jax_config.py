"""Reading configurations and robots in JAX: refusals, and no change of global settings."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero.model import aero_model
from jax_aero.base.keys import set_key
from jax_aero.base.terminal import ConfigError
from jax_aero.base.typed import scenario_config
from jax_aero.body.robot import ancestors_of, levels_of, load_robot
from jax_aero.config import AxisymmetricAeroConfig, FileWindConfig
from jax_aero.control.law.recorded import read_reference
from jax_aero.control.tick import momentum_controller
from jax_aero.sim import prepare
from jax_aero.sim.plant import n_ticks
from jax_aero.sim.wind import wind_model, wind_velocity
from jax_aero.types import Static, pytree, with_dtype

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = sorted((ROOT / "configs" / "experiments").glob("*.toml"))
MK1 = ROOT / "configs" / "robot" / "ironcub_mk1.toml"


@pytest.fixture(scope="module")
def table():
    return rust.load_config(ROOT / "configs" / "experiments" / "test2.toml")


def test_a_wind_file_may_begin_with_an_empty_line(tmp_path):
    path = tmp_path / "wind.csv"
    path.write_text("\ntime, x, y, z\n0,1,2,3\n \n2,3,-4,5\n")
    with jax.enable_x64(True):
        ours = wind_velocity(wind_model(FileWindConfig(path=str(path))), 0.5)
    np.testing.assert_array_equal(ours, rust.wind_velocity({"profile": "file", "path": str(path)}, [0.5])[0])


def read_wind(path):
    return wind_model(FileWindConfig(path=str(path)))


POSES = "time,x,y,z,roll,pitch,yaw"


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        (read_wind, "time,y,x,z\n0,0,-1,0\n", "line 1 of wind file .*; expected the header time,x,y,z"),
        (read_wind, "0,0,-1,0\n1,0,-5,0\n", "line 1 of wind file .*; expected the header time,x,y,z"),
        (read_wind, "time,x,y,z\n0,0,-1,0\n1,0,nan,0\n", "line 3 of wind file .*; expected four finite numbers"),
        (read_wind, "time,x,y,z\n0,0,-1,0\n1,0,-5,0\n0.5,1,-5,0\n", "line 4 of wind file .*; expected a time later"),
        (read_wind, "# a note\ntime,x,y,z\n0,1,2\n", "line 3 of wind file .*; expected 4 numbers"),
        (read_reference, "time,y,x,z,roll,pitch,yaw\n0,0,0,1,0,0,0\n", "line 1 of reference .*; expected the first 7"),
        (read_reference, "0,0,0,1,0,0,0\n1,0,0,1,0,0,0\n", "line 1 of reference .*; expected the first 7"),
        (read_reference, f"{POSES}\n1,0,0,1,0,0,0\n0,0,0,1,0,0,0\n", "line 3 of reference file .*; expected a time"),
        (read_reference, f"{POSES}\n0,0,0,1,0,0,0\n1,0,nan,1,0,0,0\n", "line 3 of reference file .*; expected finite"),
    ],
)
def test_a_table_of_times_is_refused_by_its_line(tmp_path, read, text, words):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read(path)


def test_numbers_are_leaves_and_names_are_structure(table):
    config, robot = scenario_config(table), load_robot(table["robot"])
    assert n_ticks(config.simulator) == 5000
    assert isinstance(config.controller.aero, AxisymmetricAeroConfig)

    def controller(**changes):
        changed = scenario_config(table | {"controller": table["controller"] | changes})
        return momentum_controller(changed, robot)

    with jax.enable_x64(True):
        made = controller()
        assert all(leaf.dtype == np.float64 and not getattr(leaf, "weak_type", False) for leaf in jax.tree.leaves(made))
        assert jax.tree.structure(made) != jax.tree.structure(controller(lever_arm="unrotated"))
        assert jax.tree.structure(made) == jax.tree.structure(
            controller(posture_gain=table["controller"]["posture_gain"])
        )


@pytest.mark.parametrize("section", ["", "simulator", "controller", "mission", "wind"])
def test_an_unknown_key_is_refused_by_name(table, section):
    spoilt = table | {"typo": 1} if not section else table | {section: table[section] | {"typo": 1}}
    with pytest.raises(ValueError, match=f"{section}.typo".lstrip(".")):
        scenario_config(spoilt)


def test_a_missing_key_and_an_unknown_kind_are_refused(table):
    with pytest.raises(ValueError, match=r"wind.velocity.* is missing"):
        scenario_config(table | {"wind": {"profile": "constant"}})
    with pytest.raises(ValueError, match=r"wind.profile.*storm"):
        scenario_config(table | {"wind": {"profile": "storm"}})


def test_a_set_of_coefficients_that_the_robot_lacks_is_refused(table):
    spoilt = copy.deepcopy(table)
    set_key(spoilt, "simulator.aero.coefficients", "guessed")
    typed = scenario_config(spoilt)
    with pytest.raises(ValueError, match=r"coefficients is `guessed`; .* has .*corrected"):
        aero_model(typed.simulator.aero, load_robot(typed.robot))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("simulator.time_step", 0.0101, "thrust_steepness`? is 2; expected at most 1.98"),
        ("controller.bounds.joint_steepness", 255.0, "joint_steepness`? is 255; expected at most 254.6"),
    ],
)
def test_bounds_that_oscillate_from_tick_to_tick_are_refused_as_by_the_crate(table, key, value, words):
    changed = copy.deepcopy(table)
    set_key(changed, key, value)
    for build in (lambda: prepare(changed, dtype=np.float32), lambda: rust.fly(changed)):
        with pytest.raises(ValueError, match=words):
            build()


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


def run_python(code):
    # Compiled without optimisation, which takes half the time.
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | {"XLA_FLAGS": flags},
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout


def test_importing_and_flying_change_no_global_setting():
    code = (
        "import jax, os; before = dict(jax.config.values), dict(os.environ)\n"
        "from jax_aero import rust, sim, verify\n"
        "table = rust.load_config('configs/experiments/test2.toml', {'simulator.duration': 0.05})\n"
        "print(sim.fly(table).outcome)\n"
        "print((jax.config.values, dict(os.environ)) == before, jax.numpy.ones(1).dtype)"
    )
    assert run_python(code).split() == ["completed", "True", "float32"]
