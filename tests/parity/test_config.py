"""What the one reader of configurations refuses, key by key, and the typed view of what it accepts."""

from __future__ import annotations

import pickle
from pathlib import Path

import msgspec
import pytest

from jax_aero import rust
from jax_aero.base import typed_config
from jax_aero.base.terminal import ConfigError

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
EXPERIMENTS = sorted((CONFIGS / "experiments").glob("*.toml"))


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"wind.velocity": [0, "x", 0]}, ("wind.velocity[1]", '"x"', "a number", ())),
        ({"simulator.duration": -1}, ("simulator.duration", "-1", "a number > 0", ())),
        ({"wind.velocty": [0, 0, 0]}, ("wind.velocty", None, "one of", ("wind.velocity",))),
        ({"duration": 1.0}, ("duration", None, "one of", ("simulator.duration",))),
        ({"simulator.duration.x": 1.0}, ("simulator.duration", "50.0", "a table or list that has `x`", ())),
        ({"simulator.initial.thrust": [1.0]}, ("length of simulator.initial.thrust", "1", "4, one entry per jet", ())),
    ],
)
def test_an_error_of_a_changed_key_has_its_parts_as_attributes(changes, parts):
    with pytest.raises(ConfigError) as refusal:
        rust.load_config("test2", changes)
    reason = pickle.loads(pickle.dumps(refusal.value))
    key, value, expected, suggestions = parts
    assert (reason.file, reason.key, reason.value, reason.suggestions) == (None, key, value, suggestions)
    assert reason.expected.startswith(expected)
    assert str(reason) == str(refusal.value)


def test_an_error_in_a_file_names_it(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(f"base = '{CONFIGS / 'experiments/test2.toml'}'\nwind.velocity = [0.0, 1.0]\n")
    for changes in ({}, {"simulator.duration": 1.0}):
        with pytest.raises(ConfigError) as refusal:
            rust.load_config(path, changes)
        assert (refusal.value.file, refusal.value.key) == (str(path), "wind.velocity")
        assert str(refusal.value).startswith(f"{path}: `wind.velocity` is [0.0,1.0]; expected")
    assert rust.load_config(path, {"wind.velocity": [0, 1, 0]})["wind"]["velocity"] == [0.0, 1.0, 0.0]


def test_keys_are_set_as_in_a_file(tmp_path, monkeypatch):
    """`false` removes what may be absent, a path starts at the current folder, and a table may name its `base`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gust.csv").write_text("time,x,y,z\n0,1,2,3\n")
    (tmp_path / "file.toml").write_text("profile = 'file'\npath = 'gust.csv'\n")
    changed = rust.load_config(
        "test2_observer",
        {"controller.fault_detection.engines": False, "simulator.joint_stops": False, "wind": {"base": "file.toml"}},
    )
    assert "engines" not in changed["controller"]["fault_detection"]
    assert changed["simulator"]["joint_stops"] is False
    assert changed["wind"] == {"profile": "file", "path": str(tmp_path / "gust.csv")}
    assert "wind.path" in rust.path_keys(changed)


def to_written(table):
    """A configuration as the crate writes it: lists, and no key for what is not there."""
    if isinstance(table, dict):
        return {key: to_written(value) for key, value in table.items() if value is not None}
    return [to_written(value) for value in table] if isinstance(table, list | tuple) else table


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_the_typed_view_has_every_key(path):
    config = rust.load_config(path)
    assert to_written(msgspec.to_builtins(typed_config.scenario_config(config))) == config
