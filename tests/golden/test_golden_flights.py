"""Flights are those that are stored: every signal to 1e-9 of its range, as far as last bits do not decide.

`tests/golden/README.md` says where the stored flights come from.
"""

import pytest

from jax_aero import rust
from tests.golden import flights


@pytest.mark.parametrize("name", flights.NAMES)
def test_a_flight_is_the_stored_one(name):
    stored = flights.load_stored(name)
    config = rust.load_config(name)
    flight = flights.fly(config)
    found = flights.signals(flight)
    assert set(found) >= set(stored.signals)  # a signal may be younger than the flight
    wrong = {}
    for signal, expected in stored.signals.items():
        excess = flights.difference(found[signal][stored.row], expected) / stored.tolerance[signal]
        if not (excess <= 1.0).all():
            first = int((~(excess <= 1.0)).argmax())
            wrong[signal] = (
                f"tick {stored.row[first]}: {excess[first] * stored.tolerance[signal][first]:.1e} of its range"
            )
    assert not wrong

    figures = stored.end.pop("summary")
    assert {key: getattr(flight, key) for key in stored.end} == stored.end
    tolerance = flights.SINGLE if flights.rounds_coarsely(config) else flights.DOUBLE
    summary = flights.summary(flight)
    for key, expected in figures.items():
        assert abs(summary[key] - expected) <= tolerance * max(abs(expected), flights.SMALL), key


def test_every_experiment_is_stored():
    assert sorted(path.stem for path in flights.FOLDER.glob("*.npz")) == flights.NAMES
