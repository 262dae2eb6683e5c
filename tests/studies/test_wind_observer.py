"""The estimated wind, judged over flights made up in place of the crate's."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.studies.wind_observer import study as wind_observer
from jax_aero import rust
from jax_aero.base import places
from jax_aero.results import study


def test_a_wind_is_judged_by_its_horizontal_components_when_it_has_risen():
    time = np.array([0.0, 7.9, 8.0, 9.0])
    measured = np.array([[9.0, 9.0, 9.0], [9.0, 9.0, 9.0], [3.0, 4.0, 9.0], [0.0, 1.0, 0.0]])
    log = {"time": time, "wind": np.zeros((4, 3)), "measured_wind": measured, "measured_wind_std": np.ones((4, 3))}
    errors, inside = wind_observer.wind_errors(log)
    assert errors.tolist() == [5.0, 1.0]
    assert inside.tolist() == [[False, False], [True, True]]


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
    assert study.listing(found.summary).splitlines()[0].endswith("rms 1, inside 0.5, completed 2")
    for configs, speed in zip(flown[:2], asked.speeds, strict=True):
        winds = [config["wind"] for config in configs]
        # Two flights: from ahead and from behind of the y axis, with turbulence in proportion to the wind.
        across = np.array([wind["velocity"] for wind in winds]) / np.abs(winds[0]["velocity"][1])
        np.testing.assert_allclose(across, [[0, 1, 0], [0, -1, 0]], atol=0.5)
        assert [wind["std"][2] / wind["std"][0] for wind in winds] == pytest.approx([0.3, 0.3])
        np.testing.assert_allclose(winds[0]["std"][0] / speed, wind_observer.TURBULENCE, rtol=0.5)


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("flights=0", "`flights` is 0; expected an integer ≥ 1"),
        ("seed=-1", "`seed` is -1; expected an integer ≥ 0"),
        ("speeds=[]", "`speeds` is []; expected one value or more, each once"),
        ("speeds=[6.0, 6.0]", "`speeds` is [6.0,6.0]; expected one value or more, each once"),
    ],
)
def test_what_it_cannot_be_made_of_is_named(change, words, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert wind_observer.main(["--set", change]) == 2
    assert words in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
