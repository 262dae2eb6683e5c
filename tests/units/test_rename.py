"""Old names in files of users become the new ones, and are named where a command meets them."""

import json

import pytest

from jax_aero import rust
from jax_aero.base import renamed
from jax_aero.base.files import find_damaged
from jax_aero.base.netcdf import open_dataset
from jax_aero.cli import main
from jax_aero.commands import rename
from tests.units.test_replay import run

OLD = """
base = "test1_observer"
engine = "rust"   # a comment
controller = { observer.gain_force = 2.0, engines = { confirmation = 0.1 } }
[controller.supervisor]   # limits
position = 0.6
[simulator.jets]
dynamics = "second_order"
[disturbances.joints_of_a_text]
text = "the key engine = 3"
"""
NEW = """
base = "test1_observer"
backend = "rust"   # a comment
controller = { disturbance_observer.gain_force = 2.0, fault_detection.engines = { confirmation = 0.1 } }
[controller.fault_detection.tracking_error]   # limits
position = 0.6
[simulator.jets]
dynamics = "throttled"
[disturbances.joints_of_a_text]
text = "the key engine = 3"
"""

SWEEP = """
set = { "controller.engines" = false, engine = "jax" }
robot = "engine.toml"
[[axis]]
key = "controller.supervisor.position"  # engine = 3
level = [
    { label = "engine", set = { "controller.joints" = { share_max = 0.5 } } },
    ["engine"],
    { label = 'a "b\\', set = { simulator.jets = { dynamics = 'second_order' } } },
]
[[axis.level]]
set.controller.observer = { gain_force = 2.0 }
[[claim]]
outcomes = ["completed", "descended"]
"""
NEW_SWEEP = """
set = { "controller.fault_detection.engines" = false, backend = "jax" }
robot = "engine.toml"
[[axis]]
key = "controller.fault_detection.tracking_error.position"  # engine = 3
level = [
    { label = "engine", set = { "controller.fault_detection.joints" = { effectiveness_max = 0.5 } } },
    ["engine"],
    { label = 'a "b\\', set = { simulator.jets = { dynamics = 'throttled' } } },
]
[[axis.level]]
set.controller.disturbance_observer = { gain_force = 2.0 }
[[claim]]
outcomes = ["completed", "landed"]
"""


def test_keys_and_values_are_renamed_and_the_rest_is_left():
    assert rename.toml(OLD, ()) == (NEW, [])
    assert rename.toml(NEW, ()) == (NEW, [])


def test_a_file_of_a_part_and_a_sweep():
    assert rename.toml("[joints]\nshare_max = 0.7\n", ("controller",))[0] == (
        "[fault_detection.joints]\neffectiveness_max = 0.7\n"
    )
    assert rename.toml(SWEEP, ()) == (NEW_SWEEP, [])


def test_a_tick_is_moved_by_its_user(tmp_path, capsys):
    path = tmp_path / "simulator" / "own.toml"
    path.parent.mkdir()
    path.write_text("time_step = 0.005\n")
    assert rename.main([str(path)]) == 2
    assert "`simulator.time_step` is `controller.time_step` now" in capsys.readouterr().err


def test_a_file_that_cannot_be_read_is_refused(tmp_path, capsys):
    path = tmp_path / "own.toml"
    path.write_text('engine = "rust"]')
    assert rename.main([str(path)]) == 2
    assert "own.toml" in capsys.readouterr().err
    assert path.read_text() == 'engine = "rust"]'


@pytest.mark.parametrize("new", renamed.KEYS.values())
def test_new_keys_are_keys(new):
    tables = rust.load_config("test2_observer")
    for part in new.split("."):
        assert part in tables
        tables = tables[part]


@pytest.mark.parametrize("old", renamed.KEYS)
def test_old_keys_are_refused_by_their_new_names(old, capsys):
    assert main(["fly", "test2_observer", "--set", f"{old}.x=1" if "." in old else f"{old}=1"]) == 2
    assert f"renamed to `{'.'.join(renamed.new_key(tuple(old.split('.'))))}" in capsys.readouterr().err


def test_a_result_is_of_the_same_flight(tmp_path, capsys):
    """What a manifest says, its digest and its checksums are those of a flight of today."""
    words = ("--set", "simulator.duration=0.02", "--out", tmp_path)
    assert run(capsys, "fly", "test2_observer", *words)[0] == 0
    folder = tmp_path / "test2_observer"
    today = json.loads((folder / "manifest.json").read_text())
    old = json.loads((folder / "manifest.json").read_text())
    controller = old["config"]["controller"]
    detectors = controller.pop("fault_detection")
    controller |= {"engines": detectors["engines"], "joints": detectors["joints"]}
    controller |= {"latency_monitor": detectors["latency"], "supervisor": detectors["tracking_error"]}
    controller["observer"] = controller.pop("disturbance_observer")
    old["config"]["simulator"]["time_step"] = controller.pop("time_step")
    descent, joints = controller["engines"]["descent"], controller["joints"]
    descent["range_share_min"] = descent.pop("range_fraction_min")
    joints["share_max"] = joints.pop("effectiveness_max")
    old["engine"], old["config"]["engine"] = old.pop("backend"), old["config"].pop("backend")
    old["config_digest"] = "0"
    (folder / "manifest.json").write_text(json.dumps(old))
    assert rename.main([str(tmp_path)]) == 0
    now = json.loads((folder / "manifest.json").read_text())
    assert {**now, "files": None} == {**today, "files": None}
    assert find_damaged(folder, now["files"]) is None
    with open_dataset(folder / "run.nc") as dataset:
        assert (dataset.attrs["backend"], dataset.attrs["config_hash"]) == ("rust", today["config_digest"])
