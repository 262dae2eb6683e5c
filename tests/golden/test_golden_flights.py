"""Flights are those that are stored: every signal to 1e-9 of its range, as far as last bits do not decide.

Those of the crate have the stored bits too. Where they do not, its version of the numbers is to be raised, by which
results of other numbers are distinguished (`make.py`). `tests/golden/README.md` has the source of the stored flights.
"""

import pytest

from jax_aero.results.identity import VERSIONS
from tests.golden import flights, make


@pytest.mark.parametrize("name", flights.NAMES)
def test_a_flight_is_the_stored_one(name):
    stored = flights.load_stored(name)
    config = flights.config_of(name)
    flight = flights.fly(config)
    assert set(flights.signals(flight)) >= set(stored.signals)  # a signal may be younger than the flight
    assert not flights.differences(stored, flight)

    figures = stored.end.pop("summary")
    assert {key: getattr(flight, key) for key in stored.end} == stored.end
    tolerance = flights.SINGLE if flights.rounds_coarsely(config) else flights.DOUBLE
    summary = flights.summary(flight)
    for key, expected in figures.items():
        assert abs(summary[key] - expected) <= tolerance * max(abs(expected), flights.SMALL), key
    changed = flights.what_changed(name, config, flight, flights.load_digests())
    assert not changed, "raise NUMERICS of the crate or of Python, then: python -m tests.golden.make"


def test_the_stored_flights_are_of_the_present_version():
    assert flights.load_digests().numerics == VERSIONS, "run: python -m tests.golden.make"


def test_other_numbers_under_the_same_version_are_not_stored(monkeypatch):
    """A bit of a crate's flight suffices."""
    name, fly = "test1", flights.fly

    def with_another_bit(config):
        flight = fly(config)
        flight.log["thrust"].view("u8")[100, 0] ^= 1
        return flight

    monkeypatch.setattr(flights, "fly", with_another_bit)
    with pytest.raises(SystemExit, match=f"{name} has other numbers under"):
        make.main([name])
    config, known = flights.config_of(name), flights.load_digests()
    monkeypatch.setitem(VERSIONS, "crate", known.numerics["crate"] + 1)
    assert not flights.is_unraised("numbers", config, known)


def test_every_experiment_is_stored():
    stored = sorted(path.stem for path in flights.FOLDER.glob("*.npz"))
    assert stored == sorted(flights.NAMES) == sorted(flights.load_digests().flights)
