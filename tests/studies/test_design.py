"""Designs of iRonCub-Mk3: files, trims and controllers; blocks that are not flown twice; derivatives of a cost."""

import json

import numpy as np
import pytest

from experiments.studies.design import campaign, robots, sensitivity, study
from experiments.studies.design.campaign import Job
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.keys import get
from jax_aero.results.identity import Identity
from jax_aero.results.work import Work

SAME = robots.draw(1, 1)[0]


def numbers(**changes):
    return dict(zip(robots.RANGES, SAME.tolist(), strict=True)) | changes


def test_a_design_without_a_change_is_the_robot(tmp_path, agree):
    made, mk3 = (rust.Robot(path).arrays() for path in (robots.write(numbers(), tmp_path), robots.MK3))
    for key in ("masses", "coms", "inertias", "joint_positions"):
        agree(key, np.asarray(made[key]), np.asarray(mk3[key]), 1e-10)
    agree("jets", made["jets"]["rotations"], mk3["jets"]["rotations"], 1e-10)


def test_a_design_keeps_what_it_does_not_change(tmp_path, agree):
    robot = rust.Robot(robots.write(numbers(leg_mass=1.2, arm_jet_out=0.05, chest_jet_tilt=5.0), tmp_path))
    agree("mass", robot.mass, rust.Robot(robots.MK3).mass, 1e-9)
    moved = np.asarray(robot.arrays()["jets"]["positions"]) - np.asarray(
        rust.Robot(robots.MK3).arrays()["jets"]["positions"]
    )
    agree("outwards, on both sides", moved[:, 1], [0.05, -0.05, 0.0, 0.0], 1e-9)


def test_the_chosen_design_is_the_robot_of_the_kept_result(tmp_path, agree):
    figures = json.loads((places.HOME / "docs/results/design_confirmed.json").read_text())["summary"]
    kept = (part.split() for part in figures["three, numbers"].split(", "))
    written = robots.write({name: float(value) for name, value in kept}, tmp_path)
    made, chosen = (rust.Robot(path).arrays() for path in (written, places.CONFIGS / "robot" / "mk3_design.toml"))
    for key in ("masses", "coms", "inertias", "joint_positions"):
        agree(key, np.asarray(made[key]), np.asarray(chosen[key]), 1e-4)
    for key in ("positions", "rotations"):
        agree(key, np.asarray(made["jets"][key]), np.asarray(chosen["jets"][key]), 1e-4)


def test_the_trim_balances_the_robot(tmp_path, measured):
    path = robots.write(numbers(leg=1.1, chest_jet_out=0.05), tmp_path)
    trim, config = robots.fit(path, rust.load_config(campaign.BASE))
    assert not trim.missed
    robot = rust.Robot(path)
    measured("thrust over weight", abs(trim.thrust.sum() / (robot.mass * robot.gravity) - 1.0), 0.2)
    own = rust.load_config(campaign.BASE)["controller"]
    assert all(get(config["controller"], key) == get(own, key) for key in robots.OF_MK3)
    assert config["controller"]["momentum"]["c0"] != own["momentum"]["c0"]


def test_a_design_without_trim_is_not_flown():
    heavy = SAME.copy()
    heavy[list(robots.RANGES).index("chest_jet_back")] = 0.9
    (row,) = campaign.fly_block(Job(heavy[None], (0,), campaign.FLIGHTS, 1))
    assert row["missed"]
    assert np.isnan(np.array(row["figures"], dtype=float)).all()


def test_blocks_are_not_flown_twice(tmp_path, monkeypatch):
    work = Work.on(tmp_path / "designs", Identity.of({}))
    work.write_json("0", [1])
    assert campaign.fly({0: None}, work, 1) == {0: [1]}


def test_scores_are_relative_to_the_first_and_infinite_for_the_lost():
    rows = [{"missed": "", "mass": 1.0, "pitch": 0.0, "figures": np.full((1, 2, 7), 2.0)} for _ in range(3)]
    for row, lost in zip(rows, (0.0, 0.0, 1.0), strict=True):
        row["figures"][:, :, 0] = lost
    found = study.scores(study.to_dataset(np.zeros((3, len(robots.RANGES))), rows, list(campaign.FLIGHTS)))
    assert found["wind"].tolist() == [1.0, 1.0, np.inf]
    assert found["still"].tolist() == [1.0, 1.0, 1.0]


def test_a_front_holds_what_nothing_dominates():
    costs = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0], [2.0, 3.0], [2.0, 2.0], [0.0, np.nan]])
    assert study.front(costs).tolist() == [True, True, True, False, True, False]


@pytest.mark.parametrize(("kind", "index"), [("mass", (3,)), ("axis", (0, 1)), ("area", (2,)), ("joint", (2, 0))])
def test_files_of_a_change_differ_in_one_number(kind, index, tmp_path):
    robot = rust.Robot(robots.MK3)
    made = rust.Robot(sensitivity.change_files(robots.MK3, robot, tmp_path, kind, index, 0.01))
    assert made.body_names == robot.body_names
    assert (made.mass != robot.mass) == (kind == "mass")
