"""The study of a learnt residual: policies are judged by flights of the crate, beside the controller alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments.studies.policy import study as policy
from jax_aero.base import places
from jax_aero.base.terminal import ConfigError
from jax_aero.env_task import Task
from jax_aero.figures.catalogue import FIGURES
from jax_aero.train.policy import Curve, TrainingResult, init_policy

pytestmark = pytest.mark.usefixtures("x64")

FILE = """
title = "Short"
experiment = "test1"
compared = ["test2"]
duration = 0.05
seeds = [3, 4]
winds = 2
training = { steps = 2, batch = 2, ticks = 5, hidden = 2 }
"""


def trained(_, settings, seeds, **where):
    """In place of a training: the first policy does nothing, the second one turns every joint."""
    assert where["checkpoint"].suffix == ".part"
    both = jax.vmap(lambda key: init_policy(key, 27, settings.hidden))(jax.vmap(jax.random.key)(jnp.array(seeds)))
    both = replace(both, output_bias=both.output_bias.at[1].set(1.0))
    return TrainingResult(both, (Curve((0.5, 0.6), (0, 1)),) * settings.steps)


def test_policies_are_judged_beside_the_controller_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(policy, "train", trained)
    monkeypatch.setattr(policy, "FlightEnv", lambda task: task)
    (tmp_path / "short.toml").write_text(FILE)
    document = policy.STUDY.run(str(tmp_path / "short.toml"))
    found = document["summary"]
    alone, still, turning = (found[f"mean reward, {key}"] for key in ("test1", "seed 3", "seed 4"))
    assert still == alone
    assert turning < alone
    assert found["gain"] == pytest.approx(0.5 * (turning - alone))
    assert found["gain, 95 % interval, low"] <= found["gain"] <= found["gain, 95 % interval, high"]
    assert found["flights left out of steps"] == 2
    figure, hashes = FIGURES["policy"].draw_from_results(places.RESULTS / "flight", ["short"])
    assert isinstance(figure, Figure)
    assert hashes == {"short": document["config_digest"]}


def test_winds_are_those_of_the_task():
    winds = policy.draw_winds(1, 400, Task())
    speeds = np.linalg.norm(winds, axis=1)
    assert speeds.max() < 12.0
    assert np.linalg.norm(policy.draw_winds(1, 400, Task(wind_min=8.0)), axis=1).min() > 8.0
    assert abs(speeds.mean() - 6.0) < 0.5
    assert np.abs(winds.mean(axis=0)).max() < 1.0
    assert not winds[:, 2].any()


def test_the_interval_covers_winds_and_seeds():
    """Seeds that agree leave the spread of the winds, and the other way round."""
    rng = np.random.default_rng(0)
    by_wind = np.tile(rng.normal(size=100), (3, 1))
    low, high = policy.interval(by_wind)
    assert high - low == pytest.approx(4 * by_wind.std() / 10, rel=0.1)
    low, high = policy.interval(np.repeat([[0.0], [1.0], [2.0]], 100, axis=1))
    assert (low, high) == (0.0, 2.0)


def test_a_seed_is_named_once(tmp_path):
    (tmp_path / "short.toml").write_text(FILE.replace("[3, 4]", "[3, 3]"))
    with pytest.raises(ConfigError, match=r"`seeds` is .*; expected each seed once"):
        policy.STUDY.read(str(tmp_path / "short.toml"))
    assert policy.STUDY.read("hover")[1].task == Task(thrust_rate=100.0, joint_velocity=1.0)
