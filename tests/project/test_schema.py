"""One description of the configuration: what follows from the crate's types is up to date, and every file fits it."""

import json
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

from experiments import schema
from jax_aero import rust

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
DATA = ("tables",)
"""Folders of measured or fitted data, which are no configuration."""
FILES = [
    path
    for path in sorted([*CONFIGS.rglob("*.toml"), *(ROOT / "experiments/studies").rglob("*.toml")])
    if not any(path.is_relative_to(CONFIGS / folder) for folder in DATA)
]
NAMES = [str(path.relative_to(ROOT)) for path in FILES]


def mistakes(schema, table):
    validator = Draft202012Validator(schema, registry=Registry(retrieve=schema_file))
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(table)]


def schema_file(name: str):
    return Resource.from_contents(json.loads((CONFIGS / "schema" / name).read_text(encoding="utf-8")))


def schema_named_by(path: Path):
    first = path.read_text(encoding="utf-8").split("\n", 1)[0]
    assert first.startswith("#:schema "), f"{path} does not name its schema"
    return json.loads((path.parent / first.removeprefix("#:schema ")).read_text(encoding="utf-8"))


def test_everything_made_from_the_types_is_up_to_date():
    made = schema.files()
    committed = {*(CONFIGS / "schema").iterdir(), *(ROOT / "experiments/studies").glob("*/schema.json")}
    assert {path for path in made if path.suffix == ".json"} == committed
    for path, text in made.items():
        assert path.read_text(encoding="utf-8") == text, f"{path} is outdated: run `python -m experiments.schema`"


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_every_file_fits_the_schema_it_names(path):
    assert mistakes(schema_named_by(path), tomllib.loads(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize("path", sorted((CONFIGS / "experiments").glob("*.toml")), ids=lambda path: path.stem)
def test_every_resolved_experiment_fits_the_schema_of_the_crate(path):
    assert mistakes(rust.schemas()["experiments"], rust.load_config(path)) == []


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        ("experiments", {"base": "test2.toml", "winds": {}}),
        ("experiments", {"base": 3}),
        ("wind", {"profile": "storm"}),
        ("wind", {"profile": "constant", "velocity": [1.0, 2.0]}),
        ("control", {"momentum": {"c0": -1.0}}),
        ("robot", {"base": "sparrow.toml"}),
        ("waypoints", {"base": "box.toml"}),
    ],
)
def test_an_editor_marks_mistakes(kind, table):
    assert mistakes(json.loads((CONFIGS / "schema" / f"{kind}.schema.json").read_text(encoding="utf-8")), table)
