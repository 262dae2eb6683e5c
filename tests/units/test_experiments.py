"""The runner, with flights that are made up in place of the crate's; configurations are real."""

import json
import re
import warnings
from pathlib import Path

import pytest
import xarray as xr

from jax_aero import cli, rust
from jax_aero.base import places, terminal, typed_config
from jax_aero.base.result import ending
from jax_aero.commands.fly import main
from jax_aero.results import flight as runner
from jax_aero.results import manifest
from jax_aero.results.table import outcome_table


@pytest.fixture
def flown(monkeypatch, make_flight):
    """Count flights instead of flying them."""
    configs = []

    def fly(config, progress=None):
        configs.append(config)
        progress(5, 10)
        flight = make_flight(step=0.5)
        robot = rust.Robot(config["robot"])
        assert len(robot.joint_names) == flight["joint_position"].shape[1]
        return flight

    monkeypatch.setattr(rust, "fly", fly)
    return configs


def test_a_flight_leaves_a_run_and_a_manifest(flown, tmp_path, capsys):
    assert main(["test1", "test2", "--out", str(tmp_path)]) == 0
    for name in ("test1", "test2"):
        assert sorted(entry.name for entry in (tmp_path / name).iterdir()) == ["manifest.json", "run.nc"]
        document = json.loads((tmp_path / name / "manifest.json").read_text())
        with xr.open_dataset(tmp_path / name / "run.nc", engine="h5netcdf") as run:
            assert run.attrs["config_hash"] == document["config_digest"]
            assert run.attrs["title"] == document["title"]
    assert len(flown) == 2
    table = capsys.readouterr().out
    assert re.search(r"test1 +completed +1\.7 +2\.9 +57\.9 +179\.2", table)


def test_the_manifest_says_all_and_names_no_path_of_this_machine(flown, tmp_path):
    assert main(["test1", "--set", "wind.velocity=[0,-12,0]", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "test1" / "manifest.json").read_text()
    document = json.loads(text)
    assert {"config", "config_digest", "seed", "command", "wall_time_s", "git", "versions", "device"} <= document.keys()
    assert document["config"]["wind"]["velocity"] == [0, -12, 0]
    assert document["config"]["robot"] == "configs/robot/ironcub_mk1.toml"
    assert document["overrides"] == {"wind.velocity": [0, -12, 0]}
    assert {"python", "numpy", "jax-aero", "flight-core"} <= document["versions"].keys()
    assert str(places.HOME) not in text
    assert str(tmp_path) not in text
    assert not re.search(r'"/', text)


def test_what_is_probably_not_meant_is_warned_of_and_stored(flown, tmp_path):
    for pitch, count in ((10, 1), (-10, 0)):
        pose = f"simulator.initial.base_rpy_deg=[0,{pitch},180]"
        words = ["test2", "--set", pose, "--out", str(tmp_path / str(pitch))]
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            assert main(words) == 0
        stored = json.loads((tmp_path / str(pitch) / "test2" / "manifest.json").read_text())["warnings"] or []
        assert len(stored) == count
        assert [str(warning.message) for warning in raised] == stored


def test_what_a_flight_does_not_use_of_a_urdf_is_named_once(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(terminal, "_WARNED", set())
    for file in (places.ROBOT, places.ROBOT.with_suffix(".urdf")):
        text = file.read_text()
        (tmp_path / file.name).write_text(text.replace("<limit ", '<dynamics friction="2" damping="5"/><limit ', 1))
    own = ["--set", f"robot={tmp_path / places.ROBOT.name}", "--out", str(tmp_path)]
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        assert main(["test1", "test2", *own]) == 0
    printed = [warnings.formatwarning(warning.message, UserWarning, "", 0) for warning in raised]
    (line,) = "".join(printed).splitlines()
    words = "<dynamics> of joint `torso_pitch` is not used: friction up to 2, damping up to 5; a flight has both in "
    assert line.startswith(f"warning: {tmp_path / 'ironcub_mk1.urdf'}: {words}")
    for name in ("test1", "test2"):
        (stored,) = json.loads((tmp_path / name / "manifest.json").read_text())["warnings"]
        assert stored.startswith(f"(outside the repository)/ironcub_mk1.urdf: {words}")


def test_an_equal_result_is_kept_and_another_one_protected(flown, tmp_path, capsys):
    out = ["--out", str(tmp_path)]
    assert main(["test1", *out]) == 0
    assert main(["test1", *out]) == 0
    assert "is finished already" in capsys.readouterr().out
    assert len(flown) == 1

    assert main(["test1", "--set", "wind.velocity=[0,0,0]", *out]) == 2
    assert "another configuration" in capsys.readouterr().err
    assert len(flown) == 1

    assert main(["test1", "--set", "wind.velocity=[0,0,0]", "--overwrite", *out]) == 0
    assert len(flown) == 2
    assert json.loads((tmp_path / "test1" / "manifest.json").read_text())["config"]["wind"]["velocity"] == [0, 0, 0]


def test_without_out_the_folder_names_what_was_set(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "folder_of", lambda name: tmp_path / name)
    assert main(["test1", "--set", "wind.velocity=[0,-12,0]"]) == 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["test1--wind.velocity=0_-12_0"]
    assert len(flown) == 1


@pytest.mark.parametrize("place", ["default", "out"])
def test_a_result_may_be_given_a_name(flown, tmp_path, monkeypatch, place):
    monkeypatch.setattr(runner, "folder_of", lambda name: tmp_path / name)
    words = ["test1", "--set", "wind.velocity=[0,-12,0]", "--name", "strong wind"]
    assert main([*words, *(["--out", str(tmp_path)] if place == "out" else [])]) == 0
    assert [entry.name for entry in tmp_path.iterdir()] == ["strong wind"]
    document = json.loads((tmp_path / "strong wind" / "manifest.json").read_text())
    assert document["name"] == "strong wind"
    assert "--name 'strong wind'" in document["command"]
    assert len(flown) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--name", "test2"], "--name is test2, the name of configs/experiments/test2.toml; expected another"),
        (["test2", "--name", "both"], "--name is both for 2 results; expected one"),
        (["--name", "../up"], "`../up`; expected a letter or digit"),
        (["--name", "a/b"], "`a/b`; expected a letter or digit"),
        (["--name", "a\n"], "expected a letter or digit"),
        (["--name", ""], "``; expected a letter or digit"),
        (["--name", "n" * 300], "File name too long"),
    ],
)
def test_a_name_that_cannot_be_given_is_refused(flown, words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "folder_of", lambda name: tmp_path / name)
    try:
        status = main(["test1", *words])
    except SystemExit as ended:
        status = ended.code
    assert status == 2
    assert message in capsys.readouterr().err
    assert flown == []


def test_the_command_of_a_manifest_can_be_typed_again(flown, tmp_path):
    words = ["test1", "--set", "simulator.duration=1", "--backend", "rust", "--overwrite"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    command = json.loads((tmp_path / "test1" / "manifest.json").read_text())["command"]
    assert command.split("--out")[0].split() == ["jax-aero", "fly", *words]


@pytest.mark.parametrize(("kind", "command"), [("experiments", "fly"), ("sweeps", "sweep")])
def test_a_list_names_a_file_that_cannot_be_read(kind, command, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(places, "CONFIGS", tmp_path)
    (tmp_path / kind).mkdir()
    (tmp_path / kind / "good.toml").write_text('title = "Good"')
    (tmp_path / kind / "broken.toml").write_text("title")
    assert cli.main([command, "--list"]) == 0
    listed = capsys.readouterr().out
    assert re.search(r"^  broken +\(.*broken\.toml: .*line 1, column 6: .* expected `=`\)$", listed, re.MULTILINE)
    assert re.search(r"^  good +Good$", listed, re.MULTILINE)


@pytest.mark.parametrize("never", [None, float("nan")])
def test_a_flight_that_was_not_lost_ends_without_a_time(never):
    assert ending("completed", never, None) == "completed"
    assert ending("off_course", never, "") == "off course"


def test_the_table_says_when_and_why_a_flight_fell():
    fallen = {
        "name": "test1",
        "outcome": "fell",
        "lost_time": 16.312,
        "lost_reason": "rotation error above 90 deg",
        "summary": {"max_com_error": 0.5, "max_rotation_error": 1.6, "thrust_min": 1.0},
    }
    table = outcome_table([fallen])
    assert "fell at 16.3 s (rotation error above 90 deg)" in table
    heading, _, row = table.splitlines()
    assert "max CoM error [cm]" in heading
    assert re.search(r"\s50\.0\s+91\.7\s+1\.0\s+\?$", row)
    down = fallen | {"outcome": "landed", "lost_time": float("nan"), "lost_reason": "", "summary": {"end_speed": 1.23}}
    assert "landed, arrives at 1.2 m/s" in outcome_table([down])


def test_paths_become_portable():
    inside = places.CONFIGS / "x.toml"
    outside = places.HOME.parent / "secret" / "x.toml"
    assert manifest.make_portable({"a": [str(inside), inside, 3]}) == {"a": ["configs/x.toml", "configs/x.toml", 3]}
    assert manifest.make_portable(str(outside)) == "(outside the repository)/x.toml"


def test_no_word_of_a_command_names_a_path_of_this_machine(flown, tmp_path):
    inside = places.CONFIGS / "wind" / "lateral_ramp.toml"
    for word, expected in (
        ("/elsewhere/a b.toml", "(outside the repository)/a b.toml"),
        ("--dataset=/elsewhere/a.nc", "--dataset=(outside the repository)/a.nc"),
        ('a=[{ b = "/elsewhere/c.csv" }, 1]', 'a=[{ b = "(outside the repository)/c.csv" }, 1]'),
        (f"a={inside}", "a=configs/wind/lateral_ramp.toml"),
        ("out/of/the/way", "out/of/the/way"),
    ):
        assert manifest._portable_word(word) == expected
    robot = tmp_path / "robot.toml"
    robot.write_text(places.ROBOT.read_text().replace('urdf = "', f'urdf = "{places.ROBOT.parent}/'))
    assert main(["test1", "--set", f'robot="{robot}"', "--out", str(tmp_path)]) == 0
    assert str(tmp_path) not in json.loads((tmp_path / "test1" / "manifest.json").read_text())["command"]


def test_seeds_are_found_at_any_depth():
    assert dict(manifest.seeds({"wind": {"seed": 3, "gust": {"seed": 4}}, "title": "seed"})) == {
        "wind.seed": 3,
        "wind.gust.seed": 4,
    }


def test_a_recording_outside_the_repository_goes_with_its_flight(tmp_path):
    """So that a log is replayed when the file is no longer there."""
    config = rust.load_config("min_time", {"simulator.duration": 1.0})
    there = tmp_path / "elsewhere" / "min_time.csv"
    there.parent.mkdir()
    there.write_bytes(Path(config["mission"]["file"]).read_bytes())
    config["mission"]["file"] = str(there)
    typed_config.copy_outside(config, tmp_path)
    stored = manifest.make_portable(config)
    assert stored["mission"]["file"] == "(outside the repository)/min_time.csv"
    there.unlink()
    placed = typed_config.make_paths_absolute(stored, tmp_path)
    assert placed["mission"]["file"] == str(tmp_path / "files" / "min_time.csv")
    assert placed["robot"] == config["robot"]
