"""Studies of flights, with flights that are made up in place of the crate's."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments import (
    along,
    arm_engines,
    identify_aero,
    observer_limit,
    wind_observer,
)
from experiments.study import Findings, Study, file_hashes
from jax_aero import cli, places, rust, tables


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
    assert found.report.startswith("  test1 P160 ")


def test_estimated_winds_are_judged_over_all_flights_of_a_speed(monkeypatch, make_flight, agree):
    """The error is 0.6 m/s and 0.8 m/s across, in half of the flights inside of their interval."""
    flown = []

    def fly_batch(configs, *, full_log):
        assert full_log
        flown.append(configs)
        results = [make_flight() for _ in configs]
        for index, flight in enumerate(results):
            flight.log["measured_wind"] = flight.log["wind"] + np.array([0.6, -0.8, 9.0])
            flight.log["measured_wind_std"] = np.full((len(flight.log["time"]), 3), 0.1 if index % 2 else 0.8)
        return results

    monkeypatch.setattr(rust, "fly_batch", fly_batch)
    asked = wind_observer.WindEstimate(worlds=tuple(wind_observer.WORLDS), speeds=(6.0, 10.0), flights=2)
    found = wind_observer.compute("turbulence", asked)
    worlds = len(asked.worlds)
    assert len(found.summary) == len(flown) == 2 * worlds
    assert found.dataset["rms"].shape == (worlds, 2)
    agree("rms", found.dataset["rms"].values, np.ones((worlds, 2)), 1e-12)
    agree("inside", found.dataset["inside"].values, np.full((worlds, 2), 0.5), 1e-12)
    assert found.report.splitlines()[0].endswith("rms 1.00 m/s, 50 % inside, 2 of 2 completed")
    for configs, speed in zip(flown[:2], asked.speeds, strict=True):
        winds = [config["wind"] for config in configs]
        # Two flights: from ahead and from behind of the y axis, with turbulence in proportion to the wind.
        across = np.array([wind["velocity"] for wind in winds]) / np.abs(winds[0]["velocity"][1])
        np.testing.assert_allclose(across, [[0, 1, 0], [0, -1, 0]], atol=0.5)
        assert [wind["std"][2] / wind["std"][0] for wind in winds] == pytest.approx([0.3, 0.3])
        np.testing.assert_allclose(winds[0]["std"][0] / speed, wind_observer.TURBULENCE, rtol=0.5)


@pytest.mark.parametrize(
    ("main", "change", "words"),
    [
        (wind_observer.main, "flights=0", "`flights` is 0; expected an integer ≥ 1"),
        (wind_observer.main, "seed=-1", "`seed` is -1; expected an integer ≥ 0"),
        (wind_observer.main, "speeds=[]", "`speeds` is []; expected one value or more, each once"),
        (wind_observer.main, "speeds=[6.0, 6.0]", "`speeds` is [6.0,6.0]; expected one value or more, each once"),
        (observer_limit.main, "gains=[1.0, 1.0]", "`gains` is [1.0,1.0]; expected one value or more, each once"),
        (observer_limit.main, "duration=0.01", "`duration` is 0.01; expected a number ≥ 0.03"),
        (along.main, "flights=[]", "`flights` is []; expected one value or more, each once"),
        (arm_engines.main, "experiments=[]", "`experiments` is []; expected one value or more, each once"),
    ],
)
def test_what_a_study_cannot_be_made_of_is_named(main, change, words, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert main(["--set", change]) == 2
    assert words in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


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
    [("fly", "experiments"), ("trim", "trim"), ("sweep", "sweeps"), ("waypoints", "waypoints"), ("cfd", "cfd")],
)
def test_ones_own_file_with_a_shipped_name_replaces_no_result(command, kind, tmp_path, capsys):
    own = tmp_path / f"{places.names(kind)[0]}.toml"
    own.touch()
    assert cli.main([command, str(own)]) == 2
    assert f"its result would take the place of that of configs/{kind}/{own.name}; rename it" in capsys.readouterr().err


class MadeUp(tables.Table, frozen=True):
    level: float
    data: Path


def test_a_result_of_other_keys_or_files_is_only_replaced_when_told(tmp_path, monkeypatch, capsys):
    computed = []

    def compute(_, config):
        computed.append(config.level)
        return Findings("Made up", xr.Dataset({"level": config.level}), {}, inputs={"level": 0.0})

    compute.__module__ = "experiments.study"  # whose code counts
    made_up = Study("made_up", None, MadeUp, compute, ("own",))
    monkeypatch.setattr(places, "RESULTS", tmp_path / "results")
    file, data = tmp_path / "own.toml", tmp_path / "own.csv"
    monkeypatch.setattr(places, "CONFIGS", tmp_path)
    (tmp_path / "made_up").mkdir()

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


def test_the_perturbation_of_the_wind_observers_flights_counts(tmp_path, monkeypatch, make_flight):
    monkeypatch.setattr(places, "RESULTS", tmp_path)

    def fly_batch(configs, *, full_log):
        return [make_flight() for _ in configs]

    monkeypatch.setattr(rust, "fly_batch", fly_batch)
    changes = {"worlds": ["axisymmetric"], "speeds": [6.0], "flights": 1}
    document = wind_observer.STUDY.run("turbulence", changes)
    assert document["config"]["flights"] == 1  # of each speed, beside the flights that it depends on
    before = document["config_digest"]
    other = tmp_path / "flight.toml"
    other.write_text(wind_observer.PERTURBATION.read_text().replace("wind_speed = 0.", "wind_speed = 0.0"))
    monkeypatch.setattr(wind_observer, "PERTURBATION", other)
    assert wind_observer.STUDY.run("turbulence", changes)["config_digest"] != before


def test_identified_areas_are_judged_by_the_forces_of_another_flight(agree):
    """Forces of 3, 2 and 1 N, moments ten times as large; two families of three links, one without a coefficient."""
    families = np.array([[1.0, 0, 0, 0, 0, 0], [0, 2.0, 0, 0, 0, 4.0]])
    truth, theta = np.full((2, 6), 0.5), np.full((2, 6), 0.25)
    six = np.repeat([1.0, 10.0], 3)
    forces = {name: np.tile(size * six, (4, 1)) for name, size in (("file", 3.0), ("identified", 2.0), ("true", 1.0))}
    data = identify_aero.to_dataset(
        families, truth, theta, np.array([9.0, 5.0, 4.0]), np.arange(4.0), forces, ["a", "b", "c"], np.array([0, 1, 0])
    )
    assert data["family"].values.tolist() == ["a c", "b"]
    agree("true areas", data["areas_true"].values, 1.5 * families, 1e-15)
    agree("identified areas", data["areas_identified"].values, 1.25 * families, 1e-15)
    found = identify_aero.figures(data.assign_attrs(loss_true=3.5))
    expected = np.sqrt(3.0) * np.array([2.0, 1.0, 20.0, 10.0, 1.0])
    agree("errors", list(found.values())[:5], expected, 1e-12)
    assert list(found.values())[5:] == [9.0, 4.0, 3.5]


def test_noise_is_added_to_the_velocities_alone():
    log = {"base_velocity": np.zeros((4000, 6)), "joint_velocity": np.zeros((4000, 2)), "thrust": np.zeros(4000)}
    noisy = identify_aero.with_noise(log, np.random.default_rng(1))
    # The standard deviation of 8000 draws is known to 1/√16000; four of them.
    for name, key in (("base_velocity", "base"), ("joint_velocity", "joints")):
        assert abs(np.std(noisy[name]) / identify_aero.NOISE[key] - 1.0) < 4.0 / np.sqrt(16000)
    assert noisy["thrust"] is log["thrust"]
