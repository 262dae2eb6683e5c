"""Studies of flights, with flights that are made up in place of the crate's."""

import importlib
import json
from pathlib import Path

import pytest
import xarray as xr

from jax_aero import cli
from jax_aero.base import places, tables
from jax_aero.base.keys import parse_assignments
from jax_aero.commands import study as studies
from jax_aero.results.study import Findings, Study, file_hashes


def test_every_file_of_one_name_is_hashed(tmp_path):
    paths = [tmp_path / folder / "robot.toml" for folder in "ab"]
    for path in paths:
        path.parent.mkdir()
        path.write_text(f"name = '{path.parent.name}'")
    both = file_hashes(paths)
    assert both == file_hashes([*reversed(paths), paths[0]])
    paths[0].write_text("name = 'c'")
    changed = file_hashes(paths)
    assert changed.keys() == both.keys() == {"(outside the repository)/robot.toml"}
    assert changed != both


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ("fly", "experiments"),
        *((f"study {name}", name) for name in studies.names() if places.names(name)),
        ("sweep", "sweeps"),
        ("robot waypoints", "waypoints"),
        ("cfd", "cfd"),
    ],
)
def test_ones_own_file_with_a_shipped_name_replaces_no_result(command, kind, tmp_path, capsys):
    own = tmp_path / f"{places.names(kind)[0]}.toml"
    own.touch()
    assert cli.main([*command.split(), str(own)]) == 2
    assert (
        f"its result would take the place of that of {places.shown_folder(kind)}/{own.name}; rename it"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("name", studies.names())
def test_every_configuration_of_a_study_has_a_schema(name):
    module = importlib.import_module(f"experiments.studies.{name}.study")
    for study in vars(module).values():
        if isinstance(study, Study):
            assert tables.schema(study.config)


class MadeUp(tables.Table, frozen=True):
    level: float
    data: Path


@pytest.mark.parametrize("name", studies.names())
def test_the_help_of_a_study_has_an_example_that_it_takes(name, capsys):
    found = getattr(importlib.import_module(f"experiments.studies.{name}.study"), "STUDY", None)
    if found is None or not found.example:
        return
    with pytest.raises(SystemExit):
        cli.main([*found.command.split(), "--help"])
    assert found.example in capsys.readouterr().out.replace("\n" + 24 * " ", " ")
    first = (places.names(found.kind) or found.names)[0]
    found.read(first, parse_assignments([found.example]))


def test_a_result_of_other_keys_or_files_is_only_replaced_when_told(tmp_path, monkeypatch, capsys):
    computed = []

    def compute(_, config):
        computed.append(config.level)
        return Findings("Made up", xr.Dataset({"level": config.level}), {}, inputs={"level": 0.0})

    made_up = Study("made_up", None, MadeUp, compute, ("own",))
    monkeypatch.setattr(places, "RESULTS", tmp_path / "results")
    file, data = tmp_path / "own.toml", tmp_path / "own.csv"
    monkeypatch.setattr(places, "CONFIGS", tmp_path)
    (tmp_path / "made_up").mkdir()
    (tmp_path / "made_up" / "shipped.toml").touch()

    def run(level, text, *options):
        file.write_text(f'level = {level}\ndata = "own.csv"\n')
        data.write_text(text)
        return made_up.main([str(file), *options])

    assert [run(1.0, "a"), run(1.0, "a")] == [0, 0]
    for other in ((2.0, "a"), (1.0, "b")):
        assert run(*other) == 2
        assert "holds the result of another configuration; choose another name or --out, or --overwrite it" in (
            capsys.readouterr().err
        )
    notes = tmp_path / "results" / "made_up" / "own" / "notes.txt"
    assert computed == [1.0, 1.0]
    assert run(2.0, "a", "--overwrite") == 0
    notes.touch()
    assert run(2.0, "a") == 2
    assert "own holds more than a result (notes.txt), so it is not overwritten" in capsys.readouterr().err
    assert computed == [1.0, 1.0, 2.0]
    assert run(2.0, "a", "--set", "level=3.0", "--name", "third") == 0
    manifest = json.loads((tmp_path / "results" / "made_up" / "third" / "manifest.json").read_text())
    assert manifest["command"].endswith("--set level=3.0 --name third")
