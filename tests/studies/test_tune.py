"""Tuning by gradient: the gradient of the cost, the loop on a toy, a run that is stopped and goes on."""

import itertools
import tomllib
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from experiments.studies.tune import pairs
from experiments.studies.tune import study as tune
from jax_aero import rust, sim
from jax_aero.base import places, plain, tables
from jax_aero.base.files import lock_work
from jax_aero.base.places import CONFIGS
from jax_aero.base.terminal import Refused
from jax_aero.train import gains
from paper_figs.figures import FIGURES

pytestmark = pytest.mark.usefixtures("x64")

STEPS = gains.Steps(count=6, batch=2, learning_rate=0.3, gradient_max=10.0, validation=4, validate_every=2)
WORLDS = """
title = "Winds about a hovering platform"
description = "Made up."
base = "platform_hover"
design = "latin_hypercube"
samples = 2
perturbation = { base_rpy_deg = 5.0, thrust = 2.0 }
axis = [{ name = "speed", key = "wind.speed", low = 2.0, high = 6.0 }]
set = { wind = { profile = "constant", velocity = [0.0, -1.0, 0.0] } }
"""
TUNE = f"""
title = "A platform, tuned"
controller = "{CONFIGS}/control/platform.toml"
worlds = "worlds.toml"
duration = 0.3
keys = ["momentum.kp_linear", "momentum.c0", "weights.thrust_rate"]
cost = {{ position = 0.05, rotation_deg = 3.0, thrust_rate = 50.0, lost = 100.0 }}
steps = {{ count = 4, batch = 2, learning_rate = 0.1, gradient_max = 100.0, validation = 2, validate_every = 2 }}
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path / "results")
    (tmp_path / "worlds.toml").write_text(WORLDS)
    (tmp_path / "toy.toml").write_text(TUNE)
    return tmp_path


@pytest.fixture(scope="module")
def scenario(x64):
    return sim.prepare(rust.load_config("test2_observer"))[0]


class Loss(NamedTuple):
    loss_tick: Any


def spring(scenario, state, n_ticks, keep):
    """In place of a flight, whose gradient tests/gradients holds to quotients: a damped mass, lost at tick 15."""
    gains = scenario.controller.momentum

    def one(at, _):
        position, velocity = at
        pull = -gains.c0 * position - gains.ko * velocity
        row = {"com_position": position, "com_setpoint": jnp.zeros(3), "thrust_rate": pull}
        row["rotation_error"] = 0.1 * velocity[0]
        return (position + 0.01 * velocity, velocity + 0.01 * pull), keep(row)

    _, kept = jax.lax.scan(one, (jnp.array([0.1, 0.0, -0.05]), jnp.zeros(3)), length=n_ticks)
    return Loss(jnp.array(15)), kept


def test_the_gradient_is_that_of_the_cost(scenario, monkeypatch, measured):
    monkeypatch.setattr(gains, "rollout", spring)
    cost = gains.Cost(position=0.05, rotation_deg=3.0, thrust_rate=50.0, lost=10.0)
    keys = ["momentum.c0", "momentum.ko"]
    of_factors = jax.jit(
        jax.value_and_grad(lambda x: gains.log_cost(gains.scale_values(scenario, keys, x), None, cost, 20))
    )
    at, step = np.array([0.1, -0.3]), 1e-5
    value, slope = of_factors(at)
    assert value > np.log(0.25 * cost.lost)  # five of twenty ticks are lost
    for index, key in enumerate(keys):
        along = step * np.eye(2)[index]
        quotient = float(of_factors(at + along)[0] - of_factors(at - along)[0]) / (2 * step)
        assert abs(float(slope[index])) > 1e-4
        because = "step² f‴/6 with f‴ of order one is 2e-11, rounding 20 ε |f|/step is 1e-9"
        measured(key, abs(float(slope[index]) - quotient), 2e-8, because=because)


def test_a_table_is_written_as_it_is_read():
    for path in sorted((CONFIGS / "control").glob("*.toml")):
        assert tomllib.loads(plain.toml(tables.read(path))) == tables.read(path), path.name
    empty = {"a": {"b": {}, "c": {"d": [1, 2.5, "é"]}}}
    assert tomllib.loads(plain.toml(empty)) == empty


def test_a_factor_scales_what_its_key_names(scenario):
    """Of numbers, lists and tables."""
    keys = ["momentum.kp_linear", "weights.thrust_rate", "posture_gain", "torque.kd", "disturbance_observer.gain_force"]
    after, before = (
        gains.scale_values(scenario, keys, jnp.log(jnp.array([2.0, 3.0, 4.0, 5.0, 6.0]))).controller,
        scenario.controller,
    )
    for got, was, factor in (
        (after.momentum.kp_linear, before.momentum.kp_linear, 2.0),
        (after.tasks.thrust_rate, before.tasks.thrust_rate, 3.0),
        (after.tasks.posture_gain, before.tasks.posture_gain, 4.0),
        (after.torque.kd, before.torque.kd, 5.0),
        (after.observer.gain_force, before.observer.gain_force, 6.0),
        (after.momentum.c0, before.momentum.c0, 1.0),
    ):
        np.testing.assert_allclose(got, factor * np.asarray(was), rtol=1e-14)  # exp(log x), a few roundings


@pytest.mark.parametrize(
    "key", ["momentum", "weights", "weights.symmetric_jets", "posture_gain.torso", "torque.torque_max"]
)
def test_a_key_that_is_no_array_of_the_controller_is_refused(scenario, key):
    with pytest.raises(ValueError, match=f"`{key}` cannot be tuned; expected what the controller has as one"):
        gains.scale_values(scenario, [key], jnp.zeros(1))


def bowl(theta, step):
    """Two worlds whose best values differ by a draw, and of every second step one whose gradient says nothing."""
    best = jnp.array([[1.0, -0.5], [1.0, -0.5]]) + 0.05 * np.random.default_rng(abs(step)).normal(size=(2, 2))
    value, slope = jax.vmap(jax.value_and_grad(lambda b: jnp.sum((theta - b) ** 2)))(best)
    return value, jnp.where(jnp.array([[True], [step % 2 == 0]]), -slope, jnp.nan)


def test_steps_lower_the_cost_and_leave_out_worlds_without_a_gradient(tmp_path):
    found = gains.tune(bowl, 2, STEPS, checkpoint=tmp_path / "c.checkpoint", digest="a")
    assert min(look.cost for look in found.validations) < 0.3 * found.validations[0].cost
    assert found.left_out == (0, 1, 0, 1, 0, 1)
    assert np.isfinite(found.logarithms).all()


def test_a_validation_that_is_worse_takes_the_values_back_and_halves_the_rate(tmp_path):
    """Where the way down leads up in unseen worlds: steps of 0.2, 0.2, 0.2 (back), 0.1 (back), 0.05, 0.05 (back)."""

    def move_away(theta, step):
        return theta[None, 0] if step >= 0 else (theta[None, 0] + 0.43) ** 2, jnp.ones((1, 1))

    steps = gains.Steps(count=6, batch=1, learning_rate=0.2, gradient_max=10.0, validation=1, validate_every=1)
    found = gains.tune(move_away, 1, steps, checkpoint=tmp_path / "c.checkpoint", digest="a")
    tried = [look.logarithms[0] for look in found.validations]
    # Adam's steps have the length of its rate, within ε.
    np.testing.assert_allclose(tried, [0.0, -0.2, -0.4, -0.6, -0.5, -0.45, -0.5], atol=1e-6)
    np.testing.assert_allclose(found.logarithms, -0.45, atol=1e-6)


def slopes(theta, group, *_):
    """In place of flights, what hangs on the factors and on the drawn winds; the last world's gradient says nothing."""
    scenario = jax.tree.unflatten(group.structure, group.stack(range(len(group.places)))[0])
    speed = jnp.linalg.norm(scenario.wind.velocity, axis=1)
    cost = jax.value_and_grad(lambda x, v: jnp.sum((x - 0.01 * v) ** 2))
    value, slope = jax.vmap(cost, in_axes=(None, 0))(theta, speed)
    return value, slope.at[-1].set(jnp.nan)


def test_a_run_that_is_killed_goes_on_to_the_same_bytes(files, monkeypatch):
    """And its controller flies, with the values of the factors."""
    monkeypatch.setattr(tune, "gradients", slopes)
    path, folder = str(files / "toy.toml"), places.RESULTS / "tune" / "toy"
    document = tune.STUDY.run(path)
    assert document["summary"]["worlds left out of steps"] == 0.5
    whole = {name: (folder / name).read_bytes() for name in ("run.nc", "toy.toml")}
    work = folder.with_name(".toy.work")
    assert not work.exists()

    calls = itertools.count()

    def kill(*arguments):
        if next(calls) == 5:  # in the fourth of four steps, one validation behind
            raise MemoryError
        return slopes(*arguments)

    monkeypatch.setattr(tune, "gradients", kill)
    with pytest.raises(MemoryError):
        tune.STUDY.run(path)
    assert list(work.rglob("steps.part"))
    tune.STUDY.run(path, {"seed": 7})  # another run, with a file of its own
    assert list(work.rglob("steps.part"))
    tune.STUDY.run(path)
    assert {name: (folder / name).read_bytes() for name in whole} == whole

    flown = files / "flight.toml"
    flown.write_text(
        f'base = "{CONFIGS}/experiments/platform_hover.toml"\ncontroller = {{ base = "{folder}/toy.toml" }}\n'
    )
    tuned, before = rust.load_config(flown), rust.load_config("platform_hover")
    factor = document["summary"]["factor of momentum.c0"]
    assert tuned["controller"]["momentum"]["c0"] == float(f"{before['controller']['momentum']['c0'] * factor:.4g}")
    assert rust.fly(rust.load_config(flown, {"simulator.duration": 0.1})).outcome == "completed"
    _, hashes = FIGURES["tune"].draw_from_results(places.RESULTS / "flight", ["toy"])
    assert hashes == {"toy": document["config_digest"]}


def test_a_run_does_not_go_on_in_other_worlds(files, monkeypatch):
    """Whose flight has changed, which the sweep names by its path."""
    flight = files / "mine.toml"
    flight.write_text(f'base = "{CONFIGS}/experiments/platform_hover.toml"\n')
    (files / "worlds.toml").write_text(WORLDS.replace('"platform_hover"', '"mine.toml"'))
    calls = itertools.count()

    def kill(*arguments):
        if next(calls) == 5:
            raise MemoryError
        return slopes(*arguments)

    monkeypatch.setattr(tune, "gradients", kill)
    with pytest.raises(MemoryError):
        tune.STUDY.run(str(files / "toy.toml"))
    text = flight.read_text()
    flight.write_text(text + "simulator = { initial = { free_fall_tick = false } }\n")
    calls = itertools.count()
    with pytest.raises(MemoryError):
        tune.STUDY.run(str(files / "toy.toml"))
    assert next(calls) == 6, "it begins anew"
    flight.write_text(text)
    document = tune.STUDY.run(str(files / "toy.toml"))
    assert list(document["sources"]["flights"]) == list(document["sources"]["configurations"]) == ["mine"]


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("momentum.c0", "momentum.c9", "`momentum.c9` in keys is no value of platform.toml"),
        ('"momentum.c0"', '"setpoint.turbo_rate"', "`setpoint.turbo_rate` cannot be tuned"),
        ('"momentum.c0"', '"momentum.kp_linear"', "`keys` is .*; expected each key once"),
        ("validation = 2", "validation = 3", "`steps.validation` is 3; expected a multiple"),
    ],
)
def test_a_mistake_is_named(files, before, after, message):
    (files / "toy.toml").write_text(TUNE.replace(before, after))
    with pytest.raises((Refused, ValueError), match=message):
        tune.STUDY.run(str(files / "toy.toml"))


def test_what_is_kept_of_work_under_way_has_one_process(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    result = tmp_path / "tune" / "aero_aware"
    with lock_work(result):
        assert tune.main([]) == 2
    assert f".{result.name}.work is being written by process" in capsys.readouterr().err
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_pairs_of_flights_are_those_that_both_complete():
    """Tuned errors are half of the published ones; a pair of which one flight is lost does not count."""
    rows = [
        {
            "world": "ideal",
            "speed": 10.0,
            "controller": controller,
            "repeat": repeat,
            "outcome": "fell" if (controller, repeat) == ("published", 2) else "completed",
            "max_rotation_error_deg": factor * (99.0 if repeat == 2 else 4.0 + repeat),
            "max_com_error": factor * 0.02,
        }
        for controller, factor in (("published", 1.0), ("tuned", 0.5))
        for repeat in range(3)
    ]
    lines = pairs.report(pd.DataFrame(rows)).splitlines()
    assert lines == [
        "ideal 10.0 m/s; complete: 2, 3",
        "  rotation: 5.0, 2.5; tuned over published 0.50 (0.50 to 0.50)",
        "  position: 2.0, 1.0; tuned over published 0.50 (0.50 to 0.50)",
    ]
