"""Every intermediate value of stored ticks, to 1e-9 of the greatest entry of each array."""

import numpy as np
import pytest

from tests.golden import ticks
from tests.golden.flights import DOUBLE


@pytest.fixture(scope="module")
def found():
    return ticks.compute()


@pytest.mark.parametrize("tick", list(ticks.load_stored()))
def test_a_tick_is_the_stored_one(found, tick):
    stored = ticks.load_stored()[tick]
    assert set(found[tick]) == set(stored), "values or modes; if on purpose, run: python -m tests.golden.ticks"
    apart = {key: ticks.difference(found[tick][key], kept) for key, kept in stored.items()}
    assert not {key: f"{error:.1e}" for key, error in apart.items() if not error <= DOUBLE}


def test_the_stored_ticks_are_those_that_are_named(found):
    assert list(ticks.load_stored()) == list(found)


def test_the_ticks_reach_what_they_are_for(found):
    """A landing before and after the loss of an engine, whose descent is planned, and air on the links."""
    modes = {tick: next(key for key in of if key.startswith("degraded_modes")) for tick, of in found.items()}
    assert "descending" not in modes["landing 70"]
    assert all("descending" in modes[f"landing {row}"] for row in (90, 130))
    assert all(of["aero_force"].greatest > 0.1 for tick, of in found.items() if not tick.endswith(" 0"))


@pytest.mark.parametrize(
    "wrong",
    [
        lambda a: a * (1.0 + 1e-8),
        lambda a: a[::-1],
        lambda a: a.T,
        lambda a: np.where(np.arange(a.size).reshape(a.shape) == 4, -a, a),
        lambda a: np.where(np.arange(a.size).reshape(a.shape) == 4, np.nan, a),
        lambda a: a[:2],
        lambda a: a + 1e-7 * np.eye(3),
    ],
)
def test_another_value_is_seen(wrong):
    right = np.array([[1.0, -2.0, 0.5], [0.3, 4.0, -np.inf], [7.0, 0.1, 2.0]])
    assert ticks.difference(ticks.keep(wrong(right)), ticks.keep(right)) > DOUBLE
    assert ticks.difference(ticks.keep(right.copy()), ticks.keep(right)) == 0.0
