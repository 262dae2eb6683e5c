"""Sweeps: what a file means, and that results do not depend on the process, the time, or interruptions."""

import importlib.metadata
import json
import math
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from jax_aero import backends, rust
from jax_aero.base import places, quantities, references
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import Refused
from jax_aero.cli import main
from jax_aero.commands import sweep as command
from jax_aero.results import identity
from jax_aero.stored import outdated
from jax_aero.sweep import aggregate, cluster, columns, keys, run, spec, table
from jax_aero.sweep import design as designs
from jax_aero.sweep import result as sweep_results
from jax_aero.sweep.design import Design
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.perturbation import DRAWS, SEED_STREAM, Perturbation, members, perturbed
from tests.cluster_task import KILLED_JOB, attempt

ENSEMBLE = places.CONFIGS / "aero" / "networks" / "ensemble" / "ensemble.json"

QUICK = """
title = "quick"
description = "short flights"
base = "test2"
repeats = {repeats}
chunk = 4
seed = 5
set = {{ "simulator.duration" = {duration} }}
perturbation = {{ joint_position = 0.02, wind_speed = 0.1, link = 0.1 }}

[[axis]]
name = "arms"
level = [{{ label = "corrected", base = "test2" }}, {{ label = "published", base = "test2_published" }}]

[[axis]]
name = "speed"
unit = "m/s"
key = "wind.speed"
values = [5, 10]
"""


def quick_sweep(folder: Path, repeats=3, duration=0.1) -> Path:
    path = folder / "quick.toml"
    path.write_text(QUICK.format(repeats=repeats, duration=duration))
    return path


def table_of(**changes):
    axis = {"name": "scale", "key": "disturbances.aero_estimate.scale", "values": [0, 1]}
    return {"title": "t", "description": "d", "base": "test2", "axis": [axis], **changes}


def design(**changes) -> Design:
    return Design(spec.from_table("made_up", table_of(**changes)))


# --- what a file means


def test_a_grid_has_every_combination_and_the_last_axis_varies_fastest(tmp_path, agree):
    quick_design = Design(spec.load(str(quick_sweep(tmp_path))))
    labels = [tuple(level.label for level in cell) for cell in quick_design.cells]
    assert labels == [("corrected", 5.0), ("corrected", 10.0), ("published", 5.0), ("published", 10.0)]
    assert quick_design.n_rows == 12
    assert quick_design.missing() == [range(4), range(4, 8), range(8, 12)]
    assert quick_design.missing([range(6), range(7, 8)]) == [range(6, 7), range(8, 12)]
    assert quick_design.place(7) == (3, 1)
    assert quick_design.cell_config(3)["simulator"]["lever_arm"] == "unrotated"
    agree("wind velocity", quick_design.cell_config(0)["wind"]["velocity"], [0.0, -5.0, 0.0], 1e-12)


def test_a_list_walks_its_axes_together():
    second = {"name": "duration", "key": "simulator.duration", "values": [1, 2]}
    cells = design(design="list", axis=[*table_of()["axis"], second]).cells
    assert [tuple(level.label for level in cell) for cell in cells] == [(0.0, 1.0), (1.0, 2.0)]


FAULTS = {
    "name": "fault",
    "level": [
        {"label": "none"},
        {"label": "wind", "set": {"disturbances.outages": [{"channel": "wind", "start": 1.0, "kind": "missing"}]}},
        {"label": "joints", "set": {"disturbances.outages": [{"channel": "joints", "start": 2.0, "kind": "frozen"}]}},
        {"label": "heavy", "set": {"disturbances.model_error.mass_scale": 0.9}},
        {"label": "light", "set": {"disturbances.model_error": {"mass_scale": 1.1}}},
    ],
}


def test_pairs_combine_what_two_levels_of_one_axis_set():
    """Lists of tables are joined, and levels of which one replaces the other are no pair."""
    speed = {"name": "speed", "key": "wind.speed", "values": [5, 10]}
    made = design(design="pairs", axis=[FAULTS, speed])
    labels = [tuple(level.label for level in cell) for cell in made.cells]
    pairs = [("none", other) for other in ("wind", "joints", "heavy", "light")]
    pairs += [("wind", "joints"), ("wind", "heavy"), ("wind", "light"), ("joints", "heavy"), ("joints", "light")]
    assert labels == [(*pair, speed) for pair in pairs for speed in (5.0, 10.0)]
    assert [axis["name"] for axis in run.describe(made.spec)["axes"]] == ["fault", "fault_2", "speed"]
    config = made.cell_config(labels.index(("wind", "joints", 5.0)))
    assert [outage["channel"] for outage in config["disturbances"]["outages"]] == ["wind", "joints"]
    config = made.cell_config(labels.index(("joints", "heavy", 10.0)))
    assert (len(config["disturbances"]["outages"]), config["disturbances"]["model_error"]["mass_scale"]) == (1, 0.9)
    made.check()


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_a_sampled_design_fills_its_box_evenly_and_repeatably(kind):
    box = [
        {"name": "x", "key": "wind.speed", "low": 2, "high": 10},
        {"name": "y", "key": "wind.direction_deg", "low": -90, "high": 90},
    ]
    cells = design(design=kind, samples=64, axis=box).cells
    again = design(design=kind, samples=64, axis=box).cells
    points = np.array([[level.label for level in cell] for cell in cells])
    assert [[level.label for level in cell] for cell in again] == points.tolist()
    assert points.shape == (64, 2)
    assert (points >= [2, -90]).all()
    assert (points <= [10, 90]).all()
    # One point in each of 64 slices: what both designs guarantee for every single axis.
    slices = np.floor((points - [2, -90]) / [8, 180] * 64).clip(0, 63)
    assert all(len(set(column)) == 64 for column in slices.T)
    assert design(design=kind, samples=64, axis=box, seed=2).cells != cells


def test_a_range_is_even_and_free_of_rounding():
    axis = {"name": "scale", "key": "disturbances.aero_estimate.scale", "range": {"start": 0, "stop": 2, "num": 11}}
    assert [level.label for level in design(axis=[axis]).spec.axis[0].levels][3] == 0.6


@pytest.mark.parametrize(
    ("speed", "direction", "velocity"), [(10, 0, [-10, 0, 0]), (10, 90, [0, -10, 0]), (5, 180, [5, 0, 0])]
)
def test_wind_is_given_by_where_it_comes_from(speed, direction, velocity, agree):
    config = {"wind": {"velocity": [0.0, -10.0, 0.0]}}
    config = keys.set_all(config, {"wind.speed": speed, "wind.direction_deg": direction})
    assert config["wind"]["velocity"] == velocity
    config = keys.set_all(config, {"wind.speed": 2 * speed})
    agree("wind speed", np.linalg.norm(config["wind"]["velocity"]), 2 * speed, 1e-12)
    config["wind"]["velocity"][2] = -1.5  # what is vertical has neither, and stays
    config = keys.set_all(config, {"wind.speed": speed})
    agree("velocity", config["wind"]["velocity"], [*velocity[:2], -1.5], 1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_speed_and_direction_of_the_wind_come_in_any_order(order, agree):
    """Also over calm air, which has no direction, and over a level that sets the wind itself."""
    still = {"wind.velocity": [0.0, 0.0, 0.0]}
    constant = {"wind": {"profile": "constant", "velocity": [0.0] * 3}}
    box = [
        {"name": "direction", "key": "wind.direction_deg", "values": [0, 90]},
        {"name": "speed", "key": "wind.speed", "values": [5]},
        {"name": "wind", "level": [{"label": "constant", "set": constant}]},
    ]
    made = design(set=still, axis=box[::order])
    velocities = [made.cell_config(cell)["wind"]["velocity"] for cell in range(2)]
    agree("velocities", velocities, [[-5.0, 0.0, 0.0], [0.0, -5.0, 0.0]], 1e-12)
    alone = design(set={**still, "wind.direction_deg": 90}, axis=[box[1]])
    agree("direction of every cell", alone.cell_config(0)["wind"]["velocity"], [0.0, -5.0, 0.0], 1e-12)
    assert design(set=still, axis=[box[1]]).cell_config(0)["wind"]["velocity"] == [-5.0, 0.0, 0.0]
    over = {"name": "wind", "level": [{"label": "a", "set": {"wind.velocity": [0.0, -3.0, 0.0]}}]}
    assert design(set={"wind.speed": 9}, axis=[over]).cell_config(0)["wind"]["velocity"] == [0.0, -3.0, 0.0]


def axes_that_set(*settings):
    return [{"name": f"a{n}", "level": [{"label": "x", "set": one}]} for n, one in enumerate(settings)]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"wind.seed": 1}, {"wind": {"profile": "turbulent"}}),
        ({"wind.speed": 1}, {"wind.speed": 2}),
        ({"simulator.jets": {"feedback": "ideal"}}, {"simulator.jets.feedback": "ideal"}),
        ({"simulator": {"jets": {"feedback": "ideal"}}}, {"simulator.jets": {}}),
        ({"disturbances.outages": [{"start": 1.0}]}, {"disturbances.outages.0.start": 2.0}),
        ({"disturbances.outages.0.start": 2.0}, {"disturbances.outages": [{"start": 1.0}]}),
        ({"wind.velocity": [1.0, 0.0, 0.0]}, {"wind.velocity": [0.0, 1.0, 0.0]}),
    ],
)
def test_an_axis_replaces_nothing_of_another(first, second):
    (lost,), (key,) = first, second
    expected = f'`axis` is "a1"; expected one that sets other keys than a0: `{key}` replaces `{lost}`'
    with pytest.raises(Refused, match=re.escape(expected)):
        design(axis=axes_that_set(first, second))


def test_axes_may_set_parts_of_one_table_and_lists_of_tables():
    design(axis=axes_that_set({"simulator.jets": {"feedback": "ideal"}}, {"simulator.jets.dynamics": "ideal"}))
    design(set={"wind.seed": 1}, axis=axes_that_set({"wind": {"profile": "constant"}}))
    design(axis=axes_that_set(*(level["set"] for level in FAULTS["level"][1:3])))
    values = [{"name": name, "key": "wind.speed", "low": 1, "high": 2} for name in ("x", "y")]
    with pytest.raises(Refused, match=r"`axis` is \"y\"; .* than x: `wind\.speed` replaces `wind\.speed`"):
        design(axis=values, design="sobol", samples=2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"backend": "matlab"}, '`backend` is "matlab"; expected one of jax, mujoco, rust'),
        ({"colour": "red"}, "unknown key `colour`"),
        (
            {"axis": [{"name": "x", "key": "wind.speed", "low": 2, "high": 1}]},
            r"`axis\[0\]\.low` is 2.*; expected a number below `high`, 1",
        ),
        ({"axis": [{"name": "x", "values": [1]}]}, r"`axis\[0\]` is .*; expected one of `key`, `keys` and `level`"),
        ({"axis": [{"name": "x", "key": "wind.speed", "keys": ["a.b"], "values": [1]}]}, "expected one of `key`"),
        (
            {"axis": [{"name": "x", "key": "wind.speed", "values": [1], "range": {"start": 0, "stop": 1, "num": 2}}]},
            r"`axis\[0\]` is .*; expected one of `values`, `range`",
        ),
        (
            {"axis": [{"name": "x", "level": [{"label": 1}, {"label": "a"}]}]},
            "expected labels that are numbers or texts alone",
        ),
        ({"samples": 8}, "`samples` is 8; expected none for a grid"),
        ({"name": "../up"}, '`name` is "../up"; expected a text'),
        ({"axis": [{"name": "x", "key": "wind.speed", "low": 1, "high": 2}]}, r"`axis\[0\]` is \"x\"; expected values"),
        (
            {"axis": [{"name": "thrust_max_p10_of_upright", "key": "wind.speed", "values": [1]}]},
            "axis `thrust_max_p10_of_upright` has the name",
        ),
        ({"panels": "world"}, '`panels` is "world"; expected the name of an axis'),
    ],
)
def test_a_mistake_in_a_file_is_named(changes, message):
    with pytest.raises(Refused, match=message):
        design(**changes)


def range_axis(number, count):
    return {"name": f"x{number}", "key": f"a.b{number}", "range": {"start": 0, "stop": 1, "num": count}}


def level_axis(name, count):
    return {"name": name, "level": [{"label": label, "set": {f"a.{name}{label}": 1}} for label in range(count)]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"axis": [range_axis(0, 10**9)]},
            r"`axis\[0\]\.range\.num` is 1000000000; expected an integer ≥ 2 and ≤ 100000",
        ),
        (
            {"axis": [range_axis(number, 1000) for number in range(6)]},
            r"`axis` is \[1000,1000.*; expected numbers of levels that make at most 100000 cells",
        ),
        ({"axis": [level_axis("x", 1001)]}, r"`axis\[0\]\.level` is .*; expected a list of at most 1000"),
        (
            {"axis": [level_axis(name, 1000) for name in "xy"]},
            r"`axis` is \[1000,1000.*; expected numbers of levels that make at most 100000 cells",
        ),
        ({"repeats": 10**6}, "`repeats` is 1000000; expected at most 500000 for 2 cells"),
    ],
)
def test_the_size_of_a_sweep_is_refused_before_it_is_made(changes, message, monkeypatch):
    monkeypatch.delattr(spec.Axis, "levels")
    with pytest.raises(Refused, match=message):
        design(**changes)


def levels_of(name, *levels):
    return {"name": name, "level": [{"label": "a", **level} for level in levels]}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {
                "design": "pairs",
                "axis": [{"name": "m", "key": "disturbances.model_error.mass_scale", "values": [1, 2]}],
            },
            '^sweep made_up: `axis` is "m"; expected levels that can be combined',
        ),
        (
            {"axis": [{"name": "x", "key": "wind.speed", "values": [1.0, 2.0, 1.0]}]},
            r"cell 2 \(x = 1.0\): cell 0 has the same levels",
        ),
        ({"axis": [levels_of("x", {}, {})]}, r"cell 1 \(x = a\): cell 0 has the same levels"),
        (
            {"axis": [levels_of("x", {"base": "test1"}), levels_of("y", {"base": "test4"})]},
            r"cell 0 \(x = a, y = a\): its levels have the `base` test1 and test4; expected one",
        ),
        ({"base": "balancing_front"}, "cell 0 .*: `backend` of the flight is 'mujoco'; expected 'rust', as of"),
        (
            {"axis": [levels_of("engine", {"set": {"backend": "jax"}})]},
            "cell 0 .*: `backend` of the flight is 'jax'; expected 'rust', as of",
        ),
        (
            {"perturbation": {"base": str(places.CONFIGS / "perturbation/unknown_robot.toml")}},
            r"`perturbation.friction` is 2.0; expected 0, as .* no `simulator.motors`",
        ),
        (
            {"perturbation": {"ensemble": str(ENSEMBLE)}},
            'cell 0 .*`simulator.aero.model` is "axisymmetric"; expected "network"',
        ),
    ],
)
def test_a_sweep_that_cannot_be_flown_is_refused_by_cell_and_key(changes, words):
    with pytest.raises(Refused, match=words):
        design(**changes).check()


def test_a_cell_that_cannot_fly_is_refused_before_the_first_flight(tmp_path):
    axis = {"name": "mass", "key": "disturbances.model_error.mass_scale", "values": [1, 0]}
    with pytest.raises(Refused, match=r"cell 1 \(mass = 0.0\): .*`disturbances.model_error.mass_scale` is 0"):
        run.run(design(axis=[axis]), workers=1, out=tmp_path)
    assert not (tmp_path / "made_up" / "chunks").exists()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"simulator": {"duration": 1.0}}, "`simulator.aero` is missing"),
        ({"simulator.initial.thrust": 5.0}, "`simulator.initial.thrust` is 5.0; expected a list"),
        ({"wind.velocity": 5.0}, "`wind.velocity` is 5.0; expected a list of 3"),
        ({"wind.velocity": 5.0, "wind.speed": 3.0}, "to set wind.speed: `wind.velocity` is 5.0; expected a list of 3"),
        ({"wind.speed": "fast"}, '`wind.speed` is "fast"; expected a number'),
        ({"wind.velocity.7": 1.0}, r"`wind.velocity` is \[.*\]; expected a table or list that has `7`"),
    ],
)
def test_what_cannot_be_set_or_perturbed_is_refused_by_sweep_cell_and_key(tmp_path, settings, message):
    changed = design(set=settings, perturbation={"thrust": 1.0, "wind_speed": 0.1})
    with pytest.raises(Refused, match=rf"sweep made_up: cell 0 \(scale = 0.0\): .*{message}"):
        run.run(changed, workers=1, out=tmp_path)


@pytest.mark.parametrize("name", places.names("sweeps"))
def test_every_sweep_of_the_repository_can_fly(name):
    loaded = Design(spec.load(name))
    step = max(1, len(loaded.cells) // 7)
    for cell in [*range(0, len(loaded.cells), step), len(loaded.cells) - 1]:
        rust.check_config(loaded.row_config(cell))
    assert loaded.spec.title
    assert loaded.spec.description


@pytest.mark.parametrize("values", [{"values": [1, 2.0]}, {"range": {"start": 1, "stop": 2, "num": 2}}])
def test_an_axis_may_vary_an_integer(values):
    """Also one that the flight leaves out."""
    estimate = {"disturbances.wind_estimate": {"noise_std": 1.0}}
    made = design(set=estimate, axis=[{"name": "seed", "key": "disturbances.wind_estimate.seed", **values}])
    made.check()
    assert repr([made.cell_config(cell)["disturbances"]["wind_estimate"]["seed"] for cell in range(2)]) == "[1, 2]"
    assert repr([level.label for (level,) in made.cells]) == "[1.0, 2.0]"
    with pytest.raises(Refused, match=r"`simulator\.substeps` is 1\.5; expected an integer"):
        design(axis=[{"name": "substeps", "key": "simulator.substeps", "values": [1.5]}]).check()


def test_a_level_removes_what_may_be_absent():
    levels = [{"label": "with", "set": {}}, {"label": "without", "set": {"controller.fault_detection.engines": False}}]
    made = design(base="test2_observer", axis=[{"name": "engines", "level": levels}])
    with_them, without = (made.cell_config(cell)["controller"] for cell in range(2))
    assert with_them["fault_detection"].pop("engines")
    assert with_them == without
    made.check()


def test_flights_that_a_sweep_names_by_their_paths_start_at_the_file(tmp_path, monkeypatch):
    """Wherever it is flown from, also where a file of it names them; what is kept of it names no folder."""
    flight = (places.CONFIGS / "experiments" / "test2.toml").read_text().replace('"../', f'"{places.CONFIGS}/')
    for folder, duration in (("flights", 1.0), ("axes", 2.0), ("elsewhere", 3.0)):
        (tmp_path / folder).mkdir()
        text = flight.replace('flight.toml"', f'flight.toml", duration = {duration}')
        (tmp_path / folder / "mine.toml").write_text(text)
    (tmp_path / "axes" / "arms.toml").write_text('name = "arms"\nlevel = [{ label = "a", base = "mine.toml" }]\n')
    (tmp_path / "mine.toml").write_text(
        'title = "t"\ndescription = "d"\nbase = "flights/mine.toml"\naxis = [{ file = "axes/arms.toml" }]\n'
    )
    monkeypatch.chdir(tmp_path / "elsewhere")
    loaded = Design(spec.load("../mine.toml"))
    assert loaded.cell_config(0)["simulator"]["duration"] == 2.0
    assert loaded.bases[loaded.spec.base]["simulator"]["duration"] == 1.0
    assert run.describe(loaded.spec)["base"] == "(outside the repository)/mine.toml"


def test_a_sweep_that_names_itself_takes_no_shipped_ones_place(tmp_path):
    path = quick_sweep(tmp_path)
    path.write_text('name = "map_wind"\n' + path.read_text())
    with pytest.raises(Refused, match=r"would take the place of that of configs/sweeps/map_wind\.toml; rename it"):
        spec.load(str(path))
    path.write_text(path.read_text().replace("map_wind", "mine"))
    own = path.rename(tmp_path / "map_wind.toml")
    assert spec.load(str(own)).name == "mine"


# --- perturbed flights


def test_a_repeat_is_perturbed_alike_in_every_cell_and_unlike_the_others(agree):
    made = design(repeats=2, perturbation={"joint_position": 0.1, "wind_direction_deg": 5.0, "drag": 0.2})
    first, second, other_cell = (made.row_config(row) for row in (0, 2, 1))
    assert first["simulator"] == other_cell["simulator"]
    assert first["disturbances"]["aero"] == other_cell["disturbances"]["aero"]
    assert first["wind"] == other_cell["wind"]
    assert first["simulator"]["initial"] != second["simulator"]["initial"]
    agree("wind speed", np.linalg.norm(first["wind"]["velocity"]), 10.0, 1e-12)
    nominal = np.array(made.cell_config(0)["simulator"]["initial"]["joint_position"])
    offsets = np.array(first["simulator"]["initial"]["joint_position"]) - nominal
    assert 0.02 < np.abs(offsets).max() <= 0.1


def test_what_is_perturbed_is_said_from_its_keys():
    assert sorted(DRAWS) == sorted(Perturbation.__struct_fields__)
    assert perturbed({"joint_position": 1e-5, "drag": 0.0}) == "start perturbed"
    assert perturbed({"ensemble": "e.json", "mass": 0.1, "any_direction": False}) == (
        "aerodynamics and model of the robot perturbed"
    )
    every = perturbed(dict.fromkeys(Perturbation.__struct_fields__, True))
    assert every.startswith("start, wind, aerodynamics, ")
    assert every.endswith("delays and friction perturbed")
    assert perturbed(dict.fromkeys(Perturbation.__struct_fields__, 0.0)) == perturbed({}) == "unperturbed"


def test_every_draw_has_random_numbers_of_its_own():
    assert sorted([SEED_STREAM, *(draw.stream for draw in DRAWS.values())]) == list(range(1 + len(DRAWS)))


def test_a_perturbation_adds_to_the_errors_of_a_level():
    """It replaced them: a level of 4 cm flew at -0.75 cm."""
    error = {"com_offset": [0.04, 0.0, -0.02], "thrust_axes": [[0.1, 0.0, 0.0]] * 4, "mass_scale": 0.9}
    levels = [{"label": "none"}, {"label": "error", "set": {"disturbances.model_error": error}}]
    made = design(
        perturbation={"com": 0.01, "thrust_axis_deg": 1.0, "mass": 0.05}, axis=[{"name": "x", "level": levels}]
    )
    drawn, both = (made.row_config(cell)["disturbances"]["model_error"] for cell in range(2))
    assert np.all(np.abs(drawn["com_offset"]) > 0.0)
    for key in ("com_offset", "thrust_axes"):
        np.testing.assert_allclose(both[key], np.add(drawn[key], error[key]), atol=1e-15)
    assert both["mass_scale"] == pytest.approx(0.9 * drawn["mass_scale"])


def test_a_perturbation_that_is_switched_on_leaves_the_others_as_they_were():
    alone, both = (
        design(perturbation=sizes).row_config(0)["simulator"]["initial"]["joint_position"]
        for sizes in ({"joint_position": 0.1}, {"joint_position": 0.1, "thrust": 2.0, "link": 0.1})
    )
    assert alone == both


@pytest.mark.parametrize(
    ("kind", "size"), [("joint_position", 0.1), ("base_rpy_deg", 3.0), ("base_velocity", 0.5), ("thrust", 2.0)]
)
def test_each_kind_perturbs_its_own_numbers_within_its_size(kind, size):
    plain = design().row_config(0)["simulator"]["initial"]
    made = design(perturbation={kind: size}).row_config(0)["simulator"]["initial"]
    assert {name for name in plain if made[name] != plain[name]} == {kind}
    apart = np.abs(np.subtract(made[kind], plain[kind]))
    assert np.all(apart > 0.0)
    assert np.all(apart <= size)


@pytest.mark.parametrize("base", ["test2", "mk3_hover"])
def test_no_thrust_is_drawn_that_its_jet_cannot_give(base):
    made = design(repeats=8, perturbation={"thrust": 300.0}, base=base)
    drawn = np.array([made.row_config(row)["simulator"]["initial"]["thrust"] for row in range(0, 16, 2)])
    robot = rust.Robot(made.row_config(0)["robot"])
    least, greatest = np.array(robot.thrust_min), np.array(robot.thrust_max)
    assert np.all((drawn >= least) & (drawn <= greatest))
    assert np.any(drawn == least)
    assert np.any(drawn == greatest)


def test_the_digest_follows_perturbations_and_weights(tmp_path):
    card = tmp_path / "card.json"
    axis = {
        "name": "net",
        "level": [{"label": "a", "set": {"simulator.aero": {"model": "network", "card": str(card)}}}],
    }
    digests = []
    for text in ("one", "other"):
        card.write_text(text)
        digests.append(design(axis=[axis]).digest)
    digests += [design(perturbation={"thrust": size}).digest for size in (0.0, 1.0, 2.0)]
    digests += [design(seed=3).digest, design(repeats=4).digest]
    assert len(set(digests)) == len(digests)


def test_titles_of_flights_change_no_sweep():
    config = rust.load_config("test2")
    renamed = config | {"title": "another", "description": "of another"}
    assert table.config_hash(renamed) == table.config_hash(config)
    assert table.config_hash(renamed | {"backend": "jax"}) != table.config_hash(config)


def test_files_of_one_name_that_change_places_make_another_sweep_of_other_rows(tmp_path):
    level = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        wind = {"profile": "file", "path": str(tmp_path / folder / "wind.csv")}
        level.append({"label": folder, "set": {"wind": wind}})
    found = []
    for texts in (("one", "other"), ("other", "one")):
        for folder, text in zip("ab", texts, strict=True):
            (tmp_path / folder / "wind.csv").write_text(text)
        made = design(axis=[{"name": "wind", "level": level}])
        configs = [made.row_config(row) for row in range(2)]
        hashes = [made.config_hash(cell, config) for cell, config in enumerate(configs)]
        rows = table.rows(made.spec, made.cells, range(2), configs, hashes, [backends.Failure("")] * 2)
        found.append((made.digest, rows["config_hash"].to_pylist()))
    (before, (one, other)), (after, swapped) = found
    assert before != after
    assert one != other
    assert swapped == [other, one]


SEEDS = ("wind.seed", "simulator.sensors.seed", "disturbances.wind_estimate.seed")


@pytest.mark.parametrize("key", SEEDS)
def test_a_seed_that_an_axis_chooses_is_flown_and_others_are_drawn(key):
    wind = {"profile": "turbulent", "velocity": [0.0, -9.0, 0.0], "ramp_start": 2.0, "ramp_end": 5.0}
    wind |= {"std": [1.0, 1.0, 0.3], "time_scale": 2.0, "seed": 1}
    chance = {"wind": wind, "disturbances.wind_estimate": {"noise_std": 1.0}}
    axis = {"name": "seed", "key": key, "values": [3, 4]}
    made = design(base="test2_sensors", set=chance, axis=[axis], repeats=2)
    flown = {of: [keys.get(made.row_config(row), of) for row in range(4)] for of in SEEDS}
    assert flown.pop(key) == [3, 4, 3, 4]
    for drawn in flown.values():
        assert drawn[::2] == drawn[1::2]
        assert drawn[0] != drawn[2]


# --- air from an ensemble


def drawing(**changes) -> Design:
    return design(base="test4", repeats=16, perturbation={"ensemble": str(ENSEMBLE)}, **changes)


def test_every_network_of_an_ensemble_flies_equally_often_in_an_order_of_the_seed():
    def cards(made: Design, cell: int) -> list[Path]:
        return [Path(made.row_config(2 * row + cell)["simulator"]["aero"]["card"]) for row in range(16)]

    drawn = cards(drawing(), 0)
    assert sorted(drawn[:8]) == sorted(drawn[8:]) == sorted(members(ENSEMBLE))
    assert drawn[:8] != drawn[8:]
    assert cards(drawing(), 1) == drawn
    assert cards(drawing(seed=2), 0) != drawn


def test_a_drawn_flight_is_that_of_its_network_to_the_bit():
    made = drawing(set={"simulator.duration": 0.02})
    rows = run.fly_chunk(made, range(0, 4, 2), backends.backend("rust"), threads=1).to_pylist()
    for row in rows:
        named = made.cell_config(0)
        named["simulator"]["aero"]["card"] = str(ENSEMBLE.with_name(f"{row['member']}.json"))
        assert row["config_hash"] == table.config_hash(named)
        alone = rust.fly_batch([named], 1)[0].summary["max_rotation_error"]
        assert row["max_rotation_error_deg"] == math.degrees(alone)
    assert rows[0]["member"] != rows[1]["member"]


def test_a_sweep_reads_each_file_and_makes_each_cell_once(monkeypatch):
    """Rows have the hashes that their configurations have alone, also where the network is drawn."""
    made, read, set_all = drawing(), [], []
    monkeypatch.setattr(designs, "file_hash", lambda path: read.append(path) or references.file_hash(path))
    change = keys.set_all
    monkeypatch.setattr(keys, "set_all", lambda *given: set_all.append(0) or change(*given))
    for row in range(made.n_rows):
        config = made.row_config(row)
        assert made.config_hash(made.place(row)[0], config) == table.config_hash(config)
    assert len(read) == len(set(read))
    assert len(set_all) == len(made.cells)


def test_a_sample_that_cannot_be_flown_is_refused_when_it_is_drawn(tmp_path):
    """Not before: there may be many, and a check takes longer than a flight."""
    axis = {"name": "factor", "key": "simulator.jets.thrust_factor", "low": 0.5, "high": 1.0}
    made = design(design="sobol", samples=8, repeats=1, axis=[axis], set={"simulator.duration": 0.02})
    reasons = [None] * 7 + ["no thrust"]
    with pytest.raises(Refused, match=r"cell 7 \(factor = 0\.\d+\): no thrust"):
        made.refuse_samples(range(8), reasons)
    made.refuse_samples(range(8, 16), reasons)  # a later repeat is a row with an error


def test_another_process_gets_no_cells(tmp_path):
    made = design()
    assert made.digest == pickle.loads(pickle.dumps(made)).digest
    assert vars(pickle.loads(pickle.dumps(made))).keys() == {"spec", "file", "bases"}


def test_an_ensemble_that_cannot_be_drawn_is_refused(tmp_path):
    other = tmp_path / "ensemble.json"
    with pytest.raises(Refused, match=r"`perturbation.ensemble` is .*; expected the path of a file that exists"):
        design(perturbation={"ensemble": str(other)})
    other.write_text('{"members": ["member_0.json"]}')
    with pytest.raises(Refused, match=r"`perturbation.ensemble` is .*; expected the ensemble.json of train-ensemble"):
        _ = design(base="test4", perturbation={"ensemble": str(other)}).digest


# --- counting


@pytest.mark.close_to_tolerance("the expected figure is typed to the digits that the tolerance allows")
@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # Source: Newcombe (1998), table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_the_interval_is_wilsons(successes, trials, low, high, measured):
    measured("interval", np.max(np.abs(np.subtract(wilson(successes, trials), (low, high)))), 6e-5)
    mirrored = wilson(trials - successes, trials)
    assert wilson(0, 0) == (0.0, 1.0)
    measured("mirrored interval", np.max(np.abs(np.subtract(mirrored, (1 - high, 1 - low)))), 6e-5)


def test_a_cell_has_counts_and_quantiles_of_its_flights(agree):
    """Eleven flights whose figures are 0 to 10; the last two fell, one of them before errors of position count."""
    ramp = np.arange(11.0)
    flights = dict.fromkeys(columns.FLIGHT, ramp) | {"outcome": np.array(["completed"] * 9 + ["fell"] * 2)}
    flights["warning_time"] = np.array([0.0] * 9 + [0.29, 0.3])
    flights["lost_time"] = np.array([np.nan] * 9 + [2.9, 8.0])
    flights["max_com_error"], flights["max_rotation_error_deg"] = 0.1 * ramp, 10.0 * ramp
    flights["max_com_error"][9] = np.nan
    found = aggregate.figures(flights)
    counted = {"flights": 11, "errors": 0, "completed": 9, "fell": 2, "degraded": 10}
    assert counted.items() <= found.items()
    assert found["on_course"] == np.sum(
        (0.1 * ramp[:9] <= aggregate.ON_COURSE_COM) & (10.0 * ramp[:9] <= aggregate.ON_COURSE_ROTATION)
    )
    agree("interval", (found["completed_low"], found["completed_high"]), wilson(9, 11), 1e-15)
    of_nine = {"p10": 0.8, "median": 4.0, "p90": 7.2, "worst": 8.0}
    for name in ("thrust_max", "thrust_min", "time_above_45_deg", "joint_error_sum_deg"):
        assert {end: found[f"{name}_{end}_of_upright"] for end in of_nine} == pytest.approx(of_nine)
    assert found["unwarned"] == 1
    agree("warning", found["warning_time_median_of_lost"], 0.295, 1e-12)
    agree("rotation", [found[f"rotation_error_deg_{end}_of_all"] for end in ("p10", "median")], [10.0, 50.0], 1e-12)
    assert found["rotation_error_deg_p90_of_all"] == found["com_error_worst_of_all"] == np.inf
    agree("position", [found[f"com_error_{end}_of_upright"] for end in ("median", "worst")], [0.4, 0.8], 1e-12)
    agree("end", [found[f"lost_time_{end}_of_lost"] for end in ("median", "worst")], [5.45, 8.0], 1e-12)


@pytest.mark.parametrize(
    ("outcome", "com_error", "counted"),
    [
        ("completed", 0.0, {"completed", "upright", "on_course"}),
        ("completed", np.nan, {"completed", "upright"}),
        ("landed", 0.0, {"landed", "upright"}),
        ("landing", 0.0, {"landing", "lost"}),
        ("off_course", 0.0, {"off_course", "lost"}),
        ("crashed", 0.0, {"crashed", "lost", "unwarned"}),
        ("fell", 0.0, {"fell", "lost", "unwarned"}),
    ],
)
def test_a_flight_counts_by_how_it_ends(outcome, com_error, counted):
    """It comes down or is lost; one that ends within its start-up has no error of position, and is not on course."""
    flights = dict.fromkeys(columns.FLIGHT, np.zeros(1)) | {"max_com_error": np.array([com_error])}
    ended = {"lost_time": np.array([1.0 if "unwarned" in counted else np.nan]), "degraded_time": np.ones(1)}
    found = aggregate.figures(flights | ended | {"outcome": np.array([outcome])})
    counts = (*columns.OUTCOMES, *columns.SHARES, "lost", "unwarned")
    assert {name for name in counts if found[name]} - {"degraded"} == counted
    expected = np.inf if "lost" in counted else None if np.isnan(com_error) else com_error
    assert found["com_error_worst_of_all"] == expected


def test_what_the_guard_finds_is_unknown_of_jax():
    summary = dict.fromkeys(rust.figures(), 1.0)
    result = rust.FlightResult({}, np.zeros(0), "completed", None, None, summary)
    for backend, known in (("rust", 1.0), ("jax", None)):
        made = design(backend=backend, repeats=1)
        flown = table.rows(made.spec, made.cells, [0], [made.row_config(0)], [""], [result])
        row = flown.to_pylist()[0]
        assert {row[name] for name in table.OF_DETECTION} == {known}
        cell = aggregate.figures({name: flown[name].to_numpy(zero_copy_only=False) for name in flown.column_names})
        assert (cell["degraded"], cell["completed"]) == (known, 1)


# --- flying


def read(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in ("table.parquet", "cells.parquet")}


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> Path:
    """A quick sweep, flown in one go."""
    folder = tmp_path_factory.mktemp("flown")
    assert main(["sweep", str(quick_sweep(folder)), "--out", str(folder), "--workers", "1"]) == 0
    return folder / "quick"


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="no list of threads, which Linux has: make test-all")
def test_tables_are_written_and_read_without_a_thread(tmp_path):
    """A process that ends while one of pyarrow's threads begins is aborted, after its results."""
    script = """
import os, sys
from pathlib import Path
import pyarrow as pa
from jax_aero.sweep.run import parquet
from jax_aero.base.parquet import read_parquet, read_table
count = lambda: len(os.listdir("/proc/self/task"))
before = count()
written = parquet(pa.table({"a": [1.0, 2.0], "b": ["x", "y"]}))
read_parquet(written)
(Path(sys.argv[1]) / "table.parquet").write_bytes(written)
read_table(Path(sys.argv[1]) / "table.parquet").to_pandas(use_threads=False)
print(count() - before)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path], capture_output=True, text=True, check=True, cwd=places.HOME
    )
    assert done.stdout == "0\n"


def test_a_sweep_leaves_a_table_of_flights_one_of_cells_and_says_what_was_flown(flown, agree):
    assert sorted(entry.name for entry in flown.iterdir()) == ["cells.parquet", "sweep.json", "table.parquet"]
    flights = pq.read_table(flown / "table.parquet").to_pylist()
    assert [row["row"] for row in flights] == list(range(12))
    assert {row["outcome"] for row in flights} == {"completed"}
    assert all(row["max_rotation_error_deg"] >= 0.0 for row in flights)
    cells = pq.read_table(flown / "cells.parquet").to_pylist()
    assert [cell["completed"] for cell in cells] == [3, 3, 3, 3]
    agree("lower end of the interval", cells[0]["completed_low"], wilson(3, 3)[0], 1e-12)
    document = json.loads((flown / "sweep.json").read_text())
    assert document["finished"]["outcomes"] == dict.fromkeys((*columns.OUTCOMES, "error"), 0) | {"completed": 12}
    assert {"config_digest", "numerics", "git", "versions", "device", "perturbation"} <= document.keys()
    assert str(places.HOME) not in (flown / "sweep.json").read_text()


def test_a_row_is_flown_alone(flown, tmp_path, capsys):
    words = ["fly", "--row", str(quick_sweep(tmp_path)), "7", "--out", str(tmp_path)]
    assert main(words) == 0
    row = pq.read_table(flown / "table.parquet").to_pylist()[7]
    document = json.loads((tmp_path / "quick--row_7" / "manifest.json").read_text())
    alone = quantities.in_columns({name: x for name, x in document["summary"].items() if x is not None})
    alone, before = (np.array([of.get(name) for name in quantities.COLUMNS], float) for of in (alone, row))
    np.testing.assert_array_equal(alone, before)
    assert main([*words[:3], "12", *words[4:]]) == 2
    assert "--row is 12 of" in capsys.readouterr().err


def test_the_cells_of_a_sweep_are_printed_unless_they_are_many(flown, monkeypatch, capsys):
    words = ["sweep", str(quick_sweep(flown.parent)), "--out", str(flown.parent)]
    assert main(words) == 0
    _, heading, _, *rows, said = capsys.readouterr().out.splitlines()
    assert heading.split()[:5] == ["arms", "speed", "[m/s]", "flights", "completed"]
    cells = pq.read_table(flown / "cells.parquet").to_pylist()
    assert len(rows) == len(cells) == 4
    for row, cell in zip(rows, cells, strict=True):
        assert f"{cell['rotation_error_deg_median_of_all']:.2f}" in row.split()
    monkeypatch.setattr(command, "MOST_CELLS", 3)
    assert main(words) == 0
    assert capsys.readouterr().out.splitlines()[1:] == [said]
    assert main([*words, "--format", "csv"]) == 0
    head, *body = capsys.readouterr().out.splitlines()
    assert (head.split(",")[:3], len(body)) == (["arms", "speed [m/s]", "flights"], 4)
    assert main([*words, "--paired", "arms", "--format", "latex"]) == 0
    *_, first, _, _, end, _ = capsys.readouterr().out.splitlines()
    assert (first.split(" & ")[:3], end) == (["5", r"published \ensuremath{-} corrected", "3"], r"\end{tabular}")


@pytest.mark.parametrize("backend", ["jax", "mujoco"])
def test_a_sweep_says_by_which_version_of_its_back_end_it_is_flown(backend):
    assert run._document(design(backend=backend), places.RESULTS)["versions"][backend] == importlib.metadata.version(
        backend
    )


def test_threads_do_not_change_a_byte(flown, tmp_path):
    assert main(["sweep", str(quick_sweep(tmp_path)), "--out", str(tmp_path), "--workers", "3"]) == 0
    assert read(tmp_path / "quick") == read(flown)


def test_a_node_of_other_numerics_flies_nothing():
    common = pickle.dumps((run._fly_remotely, (design().spec, design().bases), {"crate": 9}))
    with pytest.raises(Refused, match=r"a node has other numerics .*, here {'crate': 9}"):
        cluster._run_remotely(common, 0)


def test_a_finished_sweep_is_kept_and_another_of_its_name_protected(flown, tmp_path, capsys):
    path = quick_sweep(tmp_path)
    assert main(["sweep", str(path), "--out", str(flown.parent)]) == 0
    printed = capsys.readouterr().out
    assert "is finished already" in printed
    assert re.search(r"quick: \d+ flights in \d+ cells, ", printed)
    path.write_text(path.read_text().replace("seed = 5", "seed = 6"))
    assert main(["sweep", str(path), "--out", str(flown.parent)]) == 2
    assert "holds the result of another configuration" in capsys.readouterr().err


@pytest.mark.parametrize("is_finished", [True, False])
def test_more_repeats_continue_a_sweep(is_finished, tmp_path, capsys, stopped_sweep):
    """Three in each of four cells, then five; the flights of a finished sweep, or its chunks, are there already."""
    whole = Design(spec.load(str(quick_sweep(tmp_path, repeats=5))))
    expected = read(run.run(whole, workers=1, out=tmp_path / "whole"))
    fewer = Design(spec.load(str(quick_sweep(tmp_path))))
    if is_finished:
        table_of_fewer = pq.read_table(run.run(fewer, workers=1, out=tmp_path) / "table.parquet")
    else:
        stopped_sweep(fewer, 2, tmp_path)
    stopped_sweep(whole, 1, tmp_path)
    capsys.readouterr()
    folder = run.run(whole, workers=1, out=tmp_path)
    assert f"{16 if is_finished else 12} of 20 flights are there already" in capsys.readouterr().err
    assert read(folder) == expected
    assert json.loads((folder / "sweep.json").read_text())["repeats"] == 5
    if is_finished:
        flights = pq.read_table(folder / "table.parquet").to_pandas()
        pd.testing.assert_frame_equal(flights[:12], table_of_fewer.to_pandas(), check_exact=True)
    with pytest.raises(Refused, match="holds the result of another configuration"):
        run.run(fewer, workers=1, out=tmp_path)


def test_the_result_of_a_file_that_has_changed_is_outdated(flown):
    path = quick_sweep(flown.parent)
    text = path.read_text()
    assert outdated.result("sweeps", flown) == ""
    for seed, said in (("6", "`seed`"), ("-1", "sweep quick: `seed` is -1; expected an integer")):
        path.write_text(text.replace("seed = 5", f"seed = {seed}"))
        assert said in outdated.result("sweeps", flown)
    path.unlink()
    assert outdated.result("sweeps", flown) == ""


def test_a_finished_sweep_takes_over_how_it_is_drawn(tmp_path):
    folder = run.run(design(repeats=1, set={"simulator.duration": 0.02}), workers=1, out=tmp_path)
    before = json.loads((folder / "sweep.json").read_text())
    drawn = {"title": "new", "drawing": "levels", "panels": "scale"}
    run.run(design(repeats=1, set={"simulator.duration": 0.02}, **drawn), workers=1, out=tmp_path)
    assert json.loads((folder / "sweep.json").read_text()) == before | drawn


def test_a_long_table_is_a_folder_of_parts_that_is_read_and_continued_as_one(tmp_path, monkeypatch):
    whole = run.run(design(repeats=3, set={"simulator.duration": 0.02}), workers=1, out=tmp_path / "whole")
    monkeypatch.setattr(run, "PART_ROWS", 4)
    run.run(design(repeats=2, set={"simulator.duration": 0.02}), workers=1, out=tmp_path / "parts")
    folder = run.run(design(repeats=3, set={"simulator.duration": 0.02}), workers=1, out=tmp_path / "parts")
    assert len(list((folder / "table.parquet").iterdir())) == 2
    expected = read_table(whole / "table.parquet").to_pandas()
    assert len(expected) == 6
    for found in (read_table(folder / "table.parquet"), pq.read_table(folder / "table.parquet")):
        assert found.to_pandas().equals(expected)  # numbers that are missing are equal
    assert sweep_results.read(folder).flights.equals(sweep_results.read(whole).flights)


def test_chunks_of_other_numerics_are_not_mixed_in(tmp_path, monkeypatch, stopped_sweep):
    made, fly_chunk, flown = Design(spec.load(str(quick_sweep(tmp_path)))), run.fly_chunk, []
    stopped_sweep(made, 1, tmp_path)
    monkeypatch.setattr(run, "fly_chunk", lambda of, chunk, *rest: flown.append(chunk) or fly_chunk(of, chunk, *rest))
    monkeypatch.setitem(identity.VERSIONS, "crate", 8)
    run.run(made, workers=1, out=tmp_path)
    assert sum(map(len, flown)) == made.n_rows
    monkeypatch.setitem(identity.VERSIONS, "crate", 9)
    with pytest.raises(Refused, match=r"was made by other numerics \(crate 8 instead of 9"):
        run.run(made, workers=1, out=tmp_path)


def test_a_flight_that_fails_is_recorded_and_said_and_the_others_go_on(tmp_path, monkeypatch, capsys):
    made = Design(spec.load(str(quick_sweep(tmp_path))))
    row_config = Design.row_config

    def break_row(self, row):
        config = row_config(self, row)
        if row == 5:
            config["simulator"]["initial"]["thrust"] = [-1.0] * 4
        return config

    monkeypatch.setattr(Design, "row_config", break_row)
    folder = run.run(made, workers=1, out=tmp_path)
    assert "quick: 1 flights could not be flown, first: " in capsys.readouterr().err
    flights = pq.read_table(folder / "table.parquet").to_pylist()
    assert flights[5]["outcome"] == "error"
    assert "`simulator.initial.thrust[0]` is -1" in flights[5]["error"]
    assert [row["outcome"] for row in flights].count("completed") == 11
    cells = pq.read_table(folder / "cells.parquet").to_pylist()
    assert (cells[1]["flights"], cells[1]["errors"], cells[1]["completed"]) == (2, 1, 2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"set": {"simulator.duration": -0.5}}, "`simulator.duration` is -0.5"),
        ({"set": {"simulator.duration": "long"}}, '`simulator.duration` is "long"'),
        ({"backend": "jax", "set": {"backend": "jax"}}, 'backend = "jax" needs `nowhere.jax`'),
    ],
)
def test_a_sweep_that_cannot_fly_overwrites_nothing(tmp_path, monkeypatch, change, words):
    short = {"repeats": 1, "set": {"simulator.duration": 0.02}}
    folder = run.run(design(**short), workers=1, out=tmp_path)
    before = read(folder)
    monkeypatch.setitem(backends.MODULES, "jax", "nowhere.jax")
    with pytest.raises(Refused, match=re.escape(words)):
        run.run(design(**short | change), workers=1, out=tmp_path, overwrite=True)
    assert read(folder) == before


KILLED = """
import os, signal, sys
from jax_aero.cli import main
from jax_aero.results.work import Work

write, written = Work.write, []

def write_and_be_killed(work, job, answer):
    write(work, job, answer)
    written.append(job)
    if len(written) == 2:
        os.kill(os.getpid(), signal.SIGKILL)

Work.write = write_and_be_killed
main(sys.argv[1:])
"""
"""A command that is killed after it has kept its second chunk."""


def test_a_sweep_that_was_killed_goes_on_with_the_third_chunk_and_has_the_same_bytes(flown, tmp_path, capsys):
    words = ["sweep", str(quick_sweep(tmp_path)), "--out", str(tmp_path), "--workers", "2"]
    died = subprocess.run([sys.executable, "-c", KILLED, *words], cwd=places.HOME, capture_output=True, check=False)
    assert died.returncode == -signal.SIGKILL, died.stderr
    assert not (tmp_path / "quick").exists()
    assert main(words) == 0
    assert "8 of 12 flights are there already" in capsys.readouterr().err
    assert read(tmp_path / "quick") == read(flown)


LOOPBACK = ("0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000")
"""127.0.0.1, also as an address of IPv6, and ::1, in words of 32 bits as the kernel writes them."""


def listening(mark: str) -> set[str]:
    """Addresses on which processes listen that have `mark` in their environment."""
    sockets = {}
    for protocol in ("tcp", "tcp6"):
        for line in Path("/proc/net", protocol).read_text().splitlines():
            _, local, _, state, *_, inode = line.split()[:10]
            if state == "0A":
                sockets[f"socket:[{inode}]"] = local.partition(":")[0]
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if mark.encode() in (folder / "environ").read_bytes():
                found |= {
                    sockets[name] for link in (folder / "fd").iterdir() if (name := str(link.readlink())) in sockets
                }
    return found


def kill_one_worker(mark: str, killed: list[int], addresses: set[str]) -> None:
    """Wait for a process of this cluster that flies, and kill it; `mark` is in the environment of all of them."""
    while not killed:
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                flies = b"ray::_run_remotely" in (folder / "cmdline").read_bytes()
                if flies and mark.encode() in (folder / "environ").read_bytes():
                    addresses |= listening(mark)
                    os.kill(int(folder.name), signal.SIGKILL)
                    killed.append(int(folder.name))
                    return
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_ray_cluster_gives_the_same_bytes_also_where_a_worker_is_killed(tmp_path, capsys, monkeypatch):
    ray = pytest.importorskip("ray", reason="ray is not installed: make setup")
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    monkeypatch.setenv("CLUSTER_OF_THIS_TEST", str(tmp_path))
    killed: list[int] = []
    addresses: set[str] = set()
    killer = threading.Thread(target=kill_one_worker, args=(str(tmp_path), killed, addresses), daemon=True)
    killer.start()
    command = ["sweep", str(quick_sweep(tmp_path, repeats=4, duration=1.0)), "--out"]
    try:
        cluster = ["--cluster", "ray", "--workers", "2"]
        assert main([*command, str(tmp_path), *cluster]) == 0, capsys.readouterr().err
        assert len(killed) == 1, "no worker was seen to fly"
        assert addresses
        assert addresses <= set(LOOPBACK), "other machines can reach the cluster"
    finally:
        killed.append(0)
    assert not ray.is_initialized()
    assert main([*command, str(tmp_path / "here"), "--workers", "1"]) == 0
    assert read(tmp_path / "quick") == read(tmp_path / "here" / "quick")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_of_a_worker_that_is_killed_its_one_job_is_done_again(tmp_path):
    pytest.importorskip("ray", reason="ray is not installed: make setup")
    answers = dict(cluster.Ray(workers=2).spread(attempt, tmp_path, {job: job for job in range(12)}))
    assert answers == {job: job * job for job in range(12)}
    attempts = {int(path.name): path.read_text().splitlines() for path in tmp_path.iterdir()}
    assert {job: len(pids) for job, pids in attempts.items()} == dict.fromkeys(range(12), 1) | {KILLED_JOB: 2}
    assert len(set(attempts[KILLED_JOB])) == 2
