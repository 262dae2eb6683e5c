"""Conditions of engines in flight: what a transition is decided on, and a mission that goes on if one is revoked."""

import numpy as np
import pytest

from jax_aero import rust

HOVER = {"mission.forward_turbo": [], "mission.pitch_up": [], "mission.down": [], "mission.up": []}
HOVER |= {"simulator.ground_height": -3.0}
WORKS, LIMITED, UNCONFIRMED, STOPPED = range(4)
START = 0.5
"""When the base's velocity is not measured any more [s]."""


def outages(duration, *others):
    gap = {"channel": "base_velocity", "start": START, "duration": duration, "kind": "missing"}
    return {"disturbances.outages": [gap, *others]}


def fly(changes):
    """Return the result, and per tick the conditions of the engines with their evidence."""
    flight = rust.Flight(rust.load_config("robot", HOVER | changes))
    found = []
    while flight.step():
        found.append(flight.controller_state.engines())
    return flight.result(), found


def changes_of(found, jet):
    """Return times, states and evidence where the state of a jet changes [s]."""
    states = [int(engines["state"][jet]) for engines in found]
    ticks = [tick for tick in range(1, len(states)) if states[tick] != states[tick - 1]]
    return [(round(0.01 * tick, 2), states[tick], found[tick]["evidence"][jet]) for tick in ticks]


@pytest.mark.parametrize("duration", [0.3, 0.6])
def test_a_stop_in_a_gap_is_found_by_its_sensor_and_kept_by_the_momentum(duration):
    """Within 0.15 s the tick is between two measurements; the momentum keeps what it does not contradict for 0.1 s."""
    failure = {"jet": "l_arm_jet", "time": START, "kind": "off"}
    stop = {"disturbances.jets.failure": failure, "simulator.duration": START + duration + 0.3}
    _, found = fly(stop | outages(duration))
    (first, *more), *others = (changes_of(found, jet) for jet in range(4))
    assert not any(others)
    assert first[1:] == (UNCONFIRMED, "stopped_unseen")
    assert 0.1 < first[0] - START < 0.2
    ((time, state, evidence),) = more
    assert (state, evidence) == (LIMITED, "kept")
    assert 0.095 < time - START - duration < 0.15
    engines = found[-1]
    assert engines["reaches"][0, 1] < 10.0
    assert engines["is_sensor_used"].all()
    assert engines["residual"].shape == engines["before"].shape == (6,)


def test_a_sensor_that_fails_to_zero_in_a_gap_is_revoked_and_the_mission_goes_on():
    dead = {"channel": "thrust", "jet": "chest_r_jet", "start": START, "kind": "wrong", "error": -105.0}
    result, found = fly({"simulator.duration": 6.0} | outages(0.3, dead))
    (_, unconfirmed, _), (time, works, evidence) = changes_of(found, 3)
    assert (unconfirmed, works, evidence) == (UNCONFIRMED, WORKS, "given")
    assert time - START - 0.3 < 0.05
    assert list(found[-1]["is_sensor_used"]) == [1.0, 1.0, 1.0, 0.0]
    descends = np.flatnonzero(result["degraded_modes"].astype(int) & rust.MODES["descending"])
    assert descends[-1] <= round(100 * time)
    assert len(descends) == descends[-1] - descends[0] + 1
    assert result.outcome == "completed"


def test_a_wrong_sensor_in_a_gap_stops_no_engine():
    for error in (-40.0, 40.0):
        wrong = {"channel": "thrust", "jet": "l_arm_jet", "start": START + 0.2, "kind": "wrong", "error": error}
        _, found = fly({"simulator.duration": START + 0.5} | outages(0.6, wrong))
        assert not any(changes_of(found, jet) for jet in range(4))


def test_an_engine_that_stops_without_its_sensor_is_found_in_equal_times_at_every_rate():
    """By the time that measurements cover, not by their number: within 0.02 s and one of them."""
    for period in (0.01, 0.02, 0.05, 0.1):
        sensors = ("base_position", "base_rotation", "base_linear_velocity", "base_angular_velocity")
        rates = {f"simulator.sensors.{sensor}.period": period for sensor in sensors}
        failure = {"jet": "l_arm_jet", "time": 1.0, "kind": "off"}
        silent = {"channel": "thrust", "jet": "l_arm_jet", "start": 1.0, "kind": "missing"}
        changes = {"disturbances.jets.failure": failure, "disturbances.outages": [silent], "simulator.duration": 1.3}
        _, found = fly(changes | rates)
        ((time, state, evidence),) = changes_of(found, 0)
        assert (state, evidence) == (STOPPED, "missing"), period
        assert time - 1.0 < 0.07 + period, period
