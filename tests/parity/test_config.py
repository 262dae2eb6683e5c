"""Reading a configuration in both languages: the same table out of the same files, the same words for a mistake."""

from __future__ import annotations

import copy
import math
import random
import re
import shutil
from pathlib import Path

import pytest
from msgspec import inspect

from jax_aero import io, rust, tables
from jax_aero.config import (
    ControllerSection,
    Disturbances,
    ForceFactorsConfig,
    JetFaultsConfig,
    MissionConfig,
    RobotFile,
    ScenarioConfig,
    SimulatorConfig,
)
from jax_aero.keys import get, set_key
from jax_aero.robot import load_robot

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
EXPERIMENTS = sorted((CONFIGS / "experiments").glob("*.toml"))
VARIED = ["test2", "test4", "second_order_jets", "engine_out", "balancing_front", "sensor_noise", "min_time"]
"""Experiments that hold every table of a flight between them, but for the winds below."""
WINDS = [
    {"profile": "gust", "velocity": [1.0, 0.0, 0.0], "gust": [0.0, 5.0, 0.0], "start": 1.0, "duration": 2.0},
    {
        "profile": "turbulent",
        "velocity": [1.0, 0.0, 0.0],
        "ramp_start": 0.0,
        "ramp_end": 1.0,
        "std": [1.0, 1.0, 1.0],
        "time_scale": 2.0,
    },
]


def configurations():
    for name in VARIED:
        yield rust.load_config(CONFIGS / "experiments" / f"{name}.toml")
    for wind in WINDS:
        yield rust.load_config(CONFIGS / "experiments/test2.toml") | {"wind": wind}


def wrong_values(value):
    """Values of another type, or outside every range, with the part of the key where they stand."""
    yield "", {"wrong": True} if not isinstance(value, dict) else [3, 4]
    if isinstance(value, bool) or not isinstance(value, int | float):
        yield "", -1.5
    else:
        yield "", "wrong"
        yield "", True
        yield "", -1e300
    if isinstance(value, list):
        yield "", [*value, "wrong"]
    if isinstance(value, list) and value:
        yield ".0", "wrong"
    if isinstance(value, str):
        yield "", 3
    if isinstance(value, dict):
        yield ".mistyped", 3


def mistakes():
    """Every configuration with one mistake, at every key: (key, configuration)."""
    for config in configurations():
        for key in rust.config_keys(config):
            spoilt = copy.deepcopy(config)
            *parents, last = key.split(".")
            del (get(spoilt, ".".join(parents)) if parents else spoilt)[last]
            yield f"no {key}", spoilt
            for below, value in wrong_values(get(config, key)):
                spoilt = copy.deepcopy(config)
                set_key(spoilt, key + below, value)
                yield f"{key}{below} = {value}", spoilt


def words(read, config):
    """What is said of a configuration, without the hint at what was probably meant; `None` if it is accepted."""
    try:
        read(config)
    except ValueError as reason:
        text = re.sub(r"(; did you mean `\w+`\?)? \(known: .*\)$", "", str(reason).removeprefix("configuration: "))
        if choices := re.search(r"one of (.*)$", text):
            return text.replace(choices[1], ", ".join(sorted(choices[1].split(", "))))
        return text
    return None


def test_mistakes_are_refused_in_the_same_words():
    """Key, value and what was expected; what depends on the robot is left to the crate and to `prepare`."""
    for mistake, config in random.Random(1).sample(list(mistakes()), 300):
        ours, theirs = words(io.scenario_config, config), words(rust.check_config, config)
        if ours is not None:
            assert ours == theirs, mistake
        else:
            assert theirs is None or "`" not in theirs.partition(" ")[0], f"{mistake}: {theirs}"


def numbers(kind, value, key=""):
    """Every number in a value, as its key and its type; of a list the first."""
    match kind:
        case inspect.UnionType():
            tagged = [each for each in kind.types if isinstance(each, inspect.StructType) and each.tag_field]
            chosen = [each for each in tagged if value[each.tag_field] == each.tag] or kind.types
            yield from numbers(chosen[0], value, key)
        case inspect.StructType(array_like=False):
            for field in kind.fields:
                if field.encode_name in value:
                    yield from numbers(field.type, value[field.encode_name], f"{key}.{field.encode_name}")
        case inspect.DictType():
            for name, entry in value.items():
                yield from numbers(kind.value_type, entry, f"{key}.{name}")
        case inspect.VarTupleType(item_type=item) | inspect.TupleType(item_types=(item, *_)) if value:
            yield from numbers(item, value[0], f"{key}.0")
        case inspect.IntType() | inspect.FloatType():
            yield key.removeprefix("."), kind


def ends(kind):
    """The last number inside a range and the first outside, at every end."""
    for name, outwards in (("ge", -1), ("gt", -1), ("le", 1), ("lt", 1)):
        limit = getattr(kind, name)
        if limit is not None:
            step = 1 if isinstance(kind, inspect.IntType) else math.ulp(limit)
            is_part = name in ("ge", "le")
            yield (limit, limit + outwards * step) if is_part else (limit - outwards * step, limit)


def test_every_range_of_the_schema_is_that_of_both_languages():
    """Outside both refuse it in the same words; inside, the crate refuses no number for itself."""
    tried = set()
    for config in [*configurations(), rust.load_config("test1_observer")]:
        for key, kind in list(numbers(inspect.type_info(ScenarioConfig), config)):
            if (key, str(kind)) in tried:
                continue
            tried.add((key, str(kind)))
            for inside, outside in ends(kind):
                spoilt = copy.deepcopy(config)
                set_key(spoilt, key, outside)
                said = words(io.scenario_config, spoilt)
                assert said is not None, key
                assert said == words(rust.check_config, spoilt), key
                set_key(spoilt, key, inside)
                assert words(io.scenario_config, spoilt) is None, key
                said = words(rust.check_config, spoilt)
                assert said is None or key in COMBINED, f"{key} = {inside}: {said}"
    assert len(tried) > 80


COMBINED = ("simulator.time_step", "simulator.substeps")
"""Keys that the crate refuses together with others: the number of ticks, the steepness of bounds."""


def optional_keys(kind, key=""):
    """The keys that may be left out and have no default."""
    if isinstance(kind, inspect.UnionType):
        if any(isinstance(each, inspect.NoneType) for each in kind.types):
            yield key.removeprefix(".")
        kind = kind.types[0]
    if isinstance(kind, inspect.StructType) and not kind.tag_field:
        for field in kind.fields:
            yield from optional_keys(field.type, f"{key}.{field.encode_name}")


@pytest.mark.parametrize("key", list(optional_keys(inspect.type_info(ScenarioConfig))))
def test_null_is_no_value(key):
    config = rust.load_config("test2")
    set_key(config, key, None)
    said = words(io.scenario_config, config)
    assert said is not None
    assert said.startswith(f"`{key}` is null; expected")
    assert said == words(rust.check_config, config)


@pytest.mark.parametrize("key", list(optional_keys(inspect.type_info(ScenarioConfig))))
def test_false_removes_what_may_be_absent(key):
    """On the command line as in a file; other keys keep it as their value."""
    table = {}
    for value, expected in ((1.0, 1.0), (False, None), (False, None)):
        io.override(table, key, value)
        assert get(table, key) == expected
    io.override(table, "simulator.joint_stops", value=False)
    assert table["simulator"]["joint_stops"] is False


def to_written(table):
    """A configuration as the crate writes it: lists, and no key for what is not there."""
    if isinstance(table, dict):
        return {key: to_written(value) for key, value in table.items() if value is not None}
    return [to_written(value) for value in table] if isinstance(table, list | tuple) else table


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_types_and_defaults_are_those_of_the_crate(path):
    """What Python's types write out, the crate does: the same keys, the same defaults."""
    assert to_written(tables.to_builtins(io.scenario_config(io.load_config(path)))) == rust.load_config(path)


@pytest.mark.parametrize("kind", [Disturbances, ForceFactorsConfig, JetFaultsConfig, MissionConfig])
def test_a_table_of_defaults_alone(kind):
    assert tables.convert({}, kind, "nothing") == kind()


def test_required_keys_are_those_of_the_crate():
    schemas = rust.schemas()
    for name, kind in (("simulator", SimulatorConfig), ("control", ControllerSection), ("robot", RobotFile)):
        required = {field.encode_name for field in io.inspect.type_info(kind).fields if field.required}
        assert required == set(schemas[name]["required"])


FILES = {
    "sub/weak.toml": "model = 'axisymmetric'\ncoefficients = 'published'\nair_density = 1.0\n",
    "sub/none.toml": "model = 'off'\n",
    "sub/weak_jets.toml": "thrust_limit_scale = 0.9\nlag = 0.1\n",
    "sub/ramp.toml": "profile = 'ramp'\nvelocity = [1.0, 0.0, 0.0]\nramp_start = 1.0\nramp_end = 2.0\n",
    "sub/recorded.toml": "profile = 'file'\npath = 'wind.csv'\n",
    "sub/wind.csv": "time,x,y,z\n0,1,2,3\n",
}
CASES = {
    "a table merges": "[wind]\nbase = 'sub/ramp.toml'\nramp_end = 9.0\n",
    "another kind replaces": "[wind]\nbase = 'sub/ramp.toml'\nprofile = 'constant'\nvelocity = [1.0, 1.0, 1.0]\n",
    "another kind below another key": (
        "[disturbances.controller_wind]\nbase = 'sub/ramp.toml'\nprofile = 'constant'\nvelocity = [2.0, 0.0, 0.0]\n"
    ),
    "a path in a part": "[wind]\nbase = 'sub/recorded.toml'\n",
    "another model": "controller.aero = { base = 'sub/none.toml' }\nsimulator.aero = { base = 'sub/weak.toml' }\n",
    "lists are replaced": "[mission]\nup = [[1, 2]]\n",
    "a name is no kind": "[disturbances.aero_estimate.links]\nhead = 0.5\n",
    "false removes": "[disturbances.jets]\nbase = 'sub/weak_jets.toml'\nthrust_limit_scale = false\n",
}


@pytest.mark.parametrize("case", CASES)
def test_files_merge_alike(case, tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    top = tmp_path / "top.toml"
    top.write_text(f"base = '{CONFIGS / 'experiments/test2.toml'}'\n{CASES[case]}")
    ours = io.load_config(top)
    rust.check_config(ours)
    assert to_written(tables.to_builtins(io.scenario_config(ours))) == rust.load_config(top)


def test_a_part_of_the_robot_may_be_called_base(tmp_path):
    (tmp_path / "links.toml").write_text("chest = 0.2\nbase = 0.3\n")
    top = tmp_path / "top.toml"
    top.write_text(
        f"base = '{CONFIGS / 'experiments/test2.toml'}'\n"
        "disturbances.aero.links = { base = 0.5 }\ndisturbances.aero_estimate.links = { base = 'links.toml' }\n"
    )
    disturbances = io.resolve(top)["disturbances"]
    assert disturbances["aero"]["links"] == {"base": 0.5}
    assert disturbances["aero_estimate"]["links"] == {"chest": 0.2, "base": 0.3}
    with pytest.raises(ValueError, match=r"disturbances\.aero\.links names `base`, which does not exist"):
        rust.load_config(top)


def test_reading_is_bounded_in_both_languages(tmp_path):
    """Files that name the next one three times over would be read 3^16 times."""
    for depth in range(16):
        text = "\n".join(f"[{key}]\nbase = 'f{depth + 1}.toml'" for key in ("a", "b", "c"))
        (tmp_path / f"f{depth}.toml").write_text(text)
    (tmp_path / "f16.toml").write_text("")
    for load in (io.load_config, rust.load_config):
        with pytest.raises(ValueError, match="more than 256 `base` files"):
            load(tmp_path / "f0.toml")


@pytest.mark.parametrize("key", ["robot", "wind.path", "simulator.aero.card", "controller.aero.card", "mission.file"])
def test_a_path_on_the_command_line_starts_at_the_current_folder(key, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = {part: {"aero": {}} for part in ("simulator", "controller")} | {"wind": {}, "mission": {}}
    io.override(table, key, "here.txt")
    assert get(table, key) == str(tmp_path / "here.txt")
    table_key, _, last = key.rpartition(".")
    if table_key:
        given = {last: "here.txt"}
        io.override(table, table_key, given)
        assert get(table, key) == str(tmp_path / "here.txt")
        assert given == {last: "here.txt"}
    io.override(table, "title", "here.txt")
    assert table["title"] == "here.txt"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "sparrow"', 'name = "sparrow"\ngravity = -9.81'),
        ('name = "sparrow"', 'name = "sparrow"\ngravity = nan'),
        ('base_link = "pelvis"', "base_link = 3"),
        ('base_link = "pelvis"', ""),
        ("diameter = 0.14", "diameter = -0.14"),
        ("diameter = 0.14", 'diameter = "wide"'),
        ("limits_deg = [-40.0, 40.0]", "limits_deg = [-40.0]"),
        ("limits_deg = [-40.0, 40.0]", "limit_deg = [-40.0, 40.0]"),
        ("thrust_max = 100.0", "thrust_max = 0.0"),
        ("[0.0161, 0.0, 0.0319, 0.0, 0.0]", "[0.0161, 0.0, 0.0319, 0.0]"),
    ],
)
def test_mistakes_in_a_robot_are_refused_in_the_same_words(tmp_path, old, new):
    shutil.copy(CONFIGS / "robot/sparrow.urdf", tmp_path)
    text = (CONFIGS / "robot/sparrow.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "sparrow.toml"
    path.write_text(text.replace(old, new, 1))
    said = []
    for load in (rust.Robot, load_robot):
        with pytest.raises(ValueError, match=r"`") as refusal:
            load(path)
        said.append(re.sub(r"(; did you mean `\w+`\?)? \(known: .*\)$", "", str(refusal.value)).split(": ", 1)[1])
    assert said[0] == said[1]
