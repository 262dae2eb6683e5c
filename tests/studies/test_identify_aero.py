"""Identified coefficients, from made-up flights."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from experiments import Refused
from experiments.studies.identify_aero import figure
from experiments.studies.identify_aero import study as identify_aero
from jax_aero import rust
from jax_aero.view import export, recording


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


def test_without_true_areas_changes_are_judged(agree, tmp_path):
    """Forces of the file of 3 N, of the identified areas of 2 N; no true ones. The figure is drawn of them."""
    families, theta = np.array([[1.0, 0, 0, 0, 0, 0], [0, 2.0, 0, 0, 0, 4.0]]), np.full((2, 6), 0.25)
    six = np.repeat([1.0, 10.0], 3)
    forces = {name: np.tile(size * six, (4, 1)) for name, size in (("file", 3.0), ("identified", 2.0))}
    data = identify_aero.to_dataset(
        families, None, theta, np.array([9.0, 4.0]), np.arange(4.0), forces, ["a", "b", "c"], np.array([0, 1, 0])
    )
    assert not [name for name in data if str(name).endswith("true")]
    found = list(identify_aero.figures(data).values())
    agree("changes", found, [np.sqrt(3.0), 10.0 * np.sqrt(3.0), 3.0 * np.sqrt(3.0), 9.0, 4.0], 1e-12)
    figure.draw(data).savefig(tmp_path / "figure.png")


@pytest.fixture(scope="module")
def flown():
    config = rust.load_config("test2", {"simulator.duration": 0.3})
    return config, rust.fly(config)


def test_a_recorded_log_is_what_was_flown(flown, tmp_path):
    config, flight = flown
    export.write_csv(recording.from_flight(flight, config, ""), tmp_path / "log.csv")
    log = identify_aero.read_log(tmp_path / "log.csv", None, config)
    for name in ("time", *identify_aero.MEASURED, "joint_torque", "thrust_rate"):
        np.testing.assert_array_equal(log[name], flight.log[name])
    np.testing.assert_allclose(log["base_quaternion"], flight.log["base_quaternion"], atol=1e-15)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda log: {name: rows for name, rows in log.items() if name != "thrust_rate"}, "has no `thrust_rate`"),
        (lambda log: {name: rows[:11] for name, rows in log.items()}, "has 11 ticks of 0.01 s; expected more than 11"),
        (lambda log: log | {"raw_wind": log["raw_wind"] * np.nan}, "lacks numbers of `wind`"),
    ],
)
def test_a_log_that_does_not_suffice_is_refused(change, expected, flown, tmp_path):
    config, flight = flown
    read = recording.from_flight(dataclasses.replace(flight, log=change(flight.log)), config, "")
    export.write_csv(read, tmp_path / "log.csv")
    with pytest.raises(Refused, match=expected):
        identify_aero.read_log(tmp_path / "log.csv", None, config)
