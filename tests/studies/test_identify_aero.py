"""Identified coefficients, from made-up flights."""

from __future__ import annotations

import numpy as np

from experiments.studies.identify_aero import study as identify_aero


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
