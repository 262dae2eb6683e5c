"""Flights with other engines in the arms, made up in place of the crate's."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from experiments.studies.arm_engines import study as arm_engines
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.places import ROBOT


@pytest.mark.parametrize("made_up", [{"lost_time": None}, {"lost_time": 21.5}])
def test_engines_of_the_arms_are_flown_on_every_mission(monkeypatch, make_flight, made_up, agree):
    robots = []

    def fly(config):
        robots.append(tomllib.loads(Path(config["robot"]).read_text())["jets"])
        return make_flight(**made_up)

    monkeypatch.setattr(rust, "fly", fly)
    found = arm_engines.compute("paper", arm_engines.ArmEngines(experiments=("test1", "test2")))
    assert [jets[0]["engine"] for jets in robots] == ["P160"] * 2 + ["P100"] * 2
    made = make_flight(**made_up)
    assert found.summary.keys() == {f"{name} {engine}" for name in ("test1", "test2") for engine in ("P100", "P160")}
    cell = found.summary["test2 P100"]
    assert cell["outcome"] == ("fell" if made_up["lost_time"] else "completed")
    assert cell["com_error"] == made.summary["max_com_error"]
    agree("rotation error", cell["rotation_error"], np.degrees(made.summary["max_rotation_error"]), 1e-12)
    thrust = [made.log["thrust"][:, jets].max() for jets in (slice(0, 2), slice(2, 4))]
    agree("thrusts", [cell["arm_thrust_max"], cell["chest_thrust_max"]], thrust, 1e-12)
    assert found.dataset["com_error"].dims == ("experiment", "engine")


def test_only_the_arms_change():
    text = ROBOT.read_text(encoding="utf-8")
    jets = tomllib.loads(arm_engines.replace_arm_engines(text, "P100", 100.0))["jets"]
    assert [(jet["engine"], jet["thrust_max"]) for jet in jets] == [("P100", 100.0)] * 2 + [("P220", 220.0)] * 2
    assert arm_engines.replace_arm_engines(text, "P160", 160.0) == text


@pytest.mark.parametrize(
    ("change", "words"), [("experiments=[]", "`experiments` is []; expected one value or more, each once")]
)
def test_what_it_cannot_be_made_of_is_named(change, words, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert arm_engines.main(["--set", change]) == 2
    assert words in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
