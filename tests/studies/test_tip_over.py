"""The wind that tips the standing robot over, with trials made up in place of MuJoCo's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments import sources
from experiments.studies.tip_over import figure
from experiments.studies.tip_over import study as tip_over
from jax_aero import rust
from jax_aero.base import places
from jax_aero.mujoco import ground
from paper_figs.command import main as draw

ROOT = Path(__file__).resolve().parents[2]


def outcome(speed, limit):
    return {"stands": speed < limit, "slipped": False, "force": [speed, 0.0, 0.0]}


@pytest.mark.parametrize("limit", [4.2, 11.0, 39.9])
def test_the_limit_is_found_to_the_resolution(limit):
    found = tip_over.seek(lambda speed: outcome(speed, limit), 4.0, 44.0, 0.5)
    assert limit - 0.5 <= found["speed"] < limit
    assert found["force"][0] == found["speed"]


def test_what_nothing_or_everything_tips_is_said():
    assert tip_over.seek(lambda speed: outcome(speed, 100.0), 4.0, 44.0, 0.5)["speed"] == 44.0
    assert np.isnan(tip_over.seek(lambda speed: outcome(speed, 1.0), 4.0, 44.0, 0.5)["speed"])


def test_a_trial_has_the_disturbances_of_its_experiment():
    base = rust.load_config("balancing_lateral", {"disturbances.aero_estimate.scale": 0.5})
    study = tip_over.STUDY.read("ground")[1]
    for is_measured in (True, False):
        config = tip_over.trial(base, study, 12.0, 90.0, 0.5, is_measured=is_measured)
        assert config["disturbances"]["aero_estimate"]["scale"] == 0.5
        assert (config["disturbances"]["controller_wind"] == config["wind"]) is is_measured


def test_a_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    made = []

    def fly(config):
        speed = np.linalg.norm(config["wind"]["velocity"])
        made.append(speed)
        if len(made) == 5:
            raise KeyboardInterrupt
        n = 3
        log = {
            "foot_wrench": np.tile([0.0, 0.0, 200.0, 0.0, 0.0, 0.0], (n, 2, 1)),
            "aero_force_sim": np.full((n, 13, 3), speed / 13),
            "sole_position": np.zeros((n, 2, 3)),
        }
        return rust.FlightResult(log, np.zeros(23), "fell" if speed > 15.0 else "completed", None, None, {})

    monkeypatch.setattr(ground, "fly", fly)
    text = (
        (ROOT / "experiments/studies/tip_over/ground.toml")
        .read_text()
        .replace("../../../jax_aero", str(ROOT / "jax_aero"))
    )
    path = tmp_path / "small.toml"
    path.write_text(text.replace("[0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0]", "[0.0, 90.0]"))
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    with pytest.raises(KeyboardInterrupt):
        tip_over.STUDY.run(str(path))
    interrupted = len(made)
    document = tip_over.STUDY.run(str(path))
    assert all(14.5 <= value <= 15.0 for value in document["summary"].values())
    assert len(document["summary"]) == 4
    assert document["code_hash"] == sources.code_hash("experiments.studies.tip_over.study", "jax_aero.mujoco.ground")
    assert list((tmp_path / "tip_over").glob(".*")) == []
    # Four cells of two ends and seven halvings; the four trials before the interrupt are not made again.
    assert len(made) == 4 * 9 + 1
    assert interrupted == 5
    results, out = str(tmp_path / "flight"), str(tmp_path / "out")
    assert draw(["tip_over", "--runs", "small", "--results", results, "--out", out]) == 0


def test_every_friction_of_a_tip_over_study_is_drawn():
    dims, shape = ("feedback", "friction", "direction"), (2, 4, 3)
    variables = {"speed": (dims, np.ones(shape)), "slips": (dims, np.zeros(shape))}
    variables["force"] = ((*dims, "xyz"), np.ones((*shape, 3)))
    coords = {"feedback": ["with", "without"], "friction": [0.3, 0.5, 0.7, 1.0], "direction": [0.0, 90.0, 180.0]}
    drawn = figure.draw(xr.Dataset(variables, coords | {"xyz": list("xyz")}))
    lines = [line for line in drawn.axes[0].lines if line.get_linestyle() != "None"]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == len(lines) == 8
