"""One description of the configuration: what follows from the crate's types is up to date, and every file fits it."""

import json
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from referencing import Registry, Resource

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


UNSET = {
    "InitialConfig": {"base_velocity"},
    "ModelError": {"inertia_scale", "thrust_axes"},
    "OwnController": {"file", "name"},
    "ScenarioConfig": {"own_controller"},
    "SimulatorConfig": {"dynamics"},
    "WindConfig": {"path", "samples"},
    "WindEstimateConfig": {"seed"},
}
"""Keys that no file sets, by their table.

* Perturbations of sweeps draw `base_velocity`, `inertia_scale`, `thrust_axes` and every `seed`.
* A wind can be a recording (`path`, `samples`), and JAX's bodies those of MuJoCo (`dynamics`).
* A controller of one's own is its author's (`own_controller`; --controller of `jax-aero fly`).
"""


def tables_at(node, types, name):
    """Yield the tables that a node of a schema allows, with their types."""
    if "$ref" in node:
        name = node["$ref"].removeprefix("#/$defs/")
        yield from tables_at(types[name], types, name)
    if "properties" in node:
        yield name, node["properties"]
    for inner in (*node.get("anyOf", ()), *node.get("oneOf", ()), node.get("items"), node.get("additionalProperties")):
        if isinstance(inner, dict):
            yield from tables_at(inner, types, name)


def keys_set(node, value, types, name=""):
    """Yield type and key of everything that a table sets; `a.b = 1` is a table, too."""
    if isinstance(value, list):
        for entry in value:
            yield from keys_set(node, entry, types, name)
    elif isinstance(value, dict):
        known = list(tables_at(node, types, name))
        for key, inner in value.items():
            first, _, rest = key.partition(".")
            inside = {rest: inner} if rest else inner
            found = [(kind, table[first]) for kind, table in known if first in table]
            for kind, below in found:
                yield kind, first
                yield from keys_set(below, inside, types, kind)
            if not found:  # the number of an entry, or a name of the robot
                yield from keys_set(node, inside, types, name)


def changes_in(value):
    """Yield the changes to flights in a file of a sweep, training or study."""
    if isinstance(value, dict):
        for key in (value.get("key", ""), *value.get("keys", ())):  # an axis of numbers
            if "." in key:
                yield {key: 0.0}
        for key, inner in value.items():
            if "." in key or key in ("wind", "disturbances", "mission"):
                yield {key: inner}
            yield from changes_in(inner)
    elif isinstance(value, list):
        for entry in value:
            yield from changes_in(entry)


def test_every_key_of_a_flight_is_set_by_a_file():
    """A number that no file changes is a constant beside its equation."""
    crate = rust.schemas()
    flights, types = crate["experiments"], crate["experiments"]["$defs"]
    found = set()
    for path in FILES:
        if path.parent == CONFIGS / "verify":
            continue  # it has every key on purpose
        table, kind = tomllib.loads(path.read_text(encoding="utf-8")), path.parent.name
        if path.parent.parent == CONFIGS and kind in crate and kind != "robot":
            found |= set(keys_set(crate[kind], table, types, crate[kind]["title"]))
        else:
            for change in changes_in(table):
                found |= set(keys_set(flights, change, types, flights["title"]))
    keys = {(name, key) for kind in types for name, table in tables_at(types[kind], types, kind) for key in table}
    keys |= {(flights["title"], key) for key in flights["properties"]}
    unset = {}
    for name, key in keys - found:
        unset.setdefault(name, set()).add(key)
    assert unset == UNSET


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
        ("waypoints", {"base": "box.toml"}),
    ],
)
def test_an_editor_marks_mistakes(kind, table):
    assert mistakes(json.loads((CONFIGS / "schema" / f"{kind}.schema.json").read_text(encoding="utf-8")), table)
