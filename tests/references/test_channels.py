"""What the crate uses of each measurement, and its modes, are the reference's in every tick of drawn flights.

The controllers have no estimator, so that the law uses what the channels let pass.
"""

from __future__ import annotations

import json
from functools import lru_cache

import numpy as np
import pytest

from jax_aero import rust
from tests.references import channels, flights
from tests.references.channels import TOLERANCE, Channels, compare

FLIGHTS = ("test2", "test2_observer")
SENSORS = {
    "base_position": {"period": 0.05},
    "base_linear_velocity": {"period": 0.02, "noise_std": 0.02},
    "base_rotation": {"gaps": 0.2},
    "height": {"period": 0.03, "noise_std": 0.01},
}
ERRORS = {
    "wind": 8.0,
    "thrust": 50.0,
    "joints": 0.6,
    "base_position": 0.5,
    "base_rotation": 0.3,
    "base_velocity": 2.0,
    "height": 1.0,
}


def outage(channel, kind, start, duration=None, error=None):
    given = {"duration": duration, "error": error}
    return {"channel": channel, "kind": kind, "start": start} | {k: v for k, v in given.items() if v is not None}


def drawn(seed):
    """Return a flight and one to three outages of it, some of sensors that do not measure in every tick."""
    rng = np.random.default_rng(seed)
    has_sensors, outages = bool(seed % 2), []
    names = [name for name in ERRORS if has_sensors or name != "height"]
    for _ in range(rng.integers(1, 4)):
        name, kind = rng.choice(names), rng.choice(["missing", "nan", "frozen", "wrong"])
        duration = rng.choice([None, 0.03, 0.1, 0.3])
        error = ERRORS[name] * rng.uniform(0.3, 2.0) if kind == "wrong" else None
        outages.append(
            outage(str(name), str(kind), rng.uniform(0.0 if kind == "wrong" else 0.05, 0.8), duration, error)
        )
    sensors = {"simulator.sensors": SENSORS} if has_sensors else {}
    return FLIGHTS[seed % 3 % 2], {"simulator.duration": 1.0} | sensors | {"disturbances.outages": outages}


@lru_cache
def record(name, changes):
    """Return the configuration and ticks of a flight."""
    always = {"controller.channels.jump": True, "wind.ramp_start": -1.0, "wind.ramp_end": 0.0}
    config = rust.load_config(name, always | json.loads(changes))
    return config, flights.fly(config)


def fly(name, changes):
    """Return whether a flight agrees in every tick, and the modes of each."""
    return channels.follow(*record(name, json.dumps(changes)))


@pytest.mark.parametrize("seed", range(12))
def test_drawn_flights_use_what_the_reference_uses(seed):
    agrees, said = fly(*drawn(seed))
    assert agrees
    assert any(said)


LONG = {
    "no wind": [outage("wind", "missing", 0.2)],
    "wind that is wrong for too long": [outage("wind", "wrong", 1.5, 1.2, 30.0)],
    "no position": [outage("base_position", "missing", 0.2, 3.3)],
    "a first position that is wrong": [outage("base_position", "wrong", 0.0, 0.005, 0.4)],
    "a position that is wrong for long": [outage("base_position", "wrong", 0.2, None, 0.8)],
    "a rotation that is frozen": [outage("base_rotation", "frozen", 0.5, 1.0)],
}


@pytest.mark.parametrize("outages", LONG)
def test_long_outages_end_as_the_reference_says(outages):
    agrees, said = fly("test2_observer", {"simulator.duration": 4.7, "disturbances.outages": LONG[outages]})
    assert agrees
    found = set().union(*said)
    expected = {
        "no wind": {"wind_held", "wind_lost"},
        "wind that is wrong for too long": {"wind_held", "wind_lost"},
        "no position": {"position_predicted", "descending"},
        "a first position that is wrong": {"begun_again"},
        "a position that is wrong for long": {"begun_again", "position_predicted"},
        "a rotation that is frozen": {"rotation_predicted"},
    }
    assert expected[outages] <= found


@pytest.mark.parametrize("jump", [5.0, -0.1, 0.3, 0.05, 0.0, 0.004])
def test_a_clock_that_jumps_moves_the_time_as_the_reference_says(jump):
    """Between two ticks: a jump, a pause, a gap, or a step of another length; also beside a wind that is missing."""
    config = rust.load_config("test2_observer", {"controller.channels.jump": True, "simulator.duration": 0.3})
    flight, measured = rust.Flight(config), []
    while not flight.has_ended:
        measured.append(flight.measurement)
        flight.step()
    controller, last, first = rust.Controller(config), None, measured[0]
    controller.start(first.state, first.thrust, first.wind)
    reference = Channels(config, rust.Robot(config["robot"]), first)
    said = set()
    for place, now in enumerate(measured):
        wind = np.full(3, np.nan) if 5 <= place < 25 else now.wind
        now = now._replace(time=now.time + (jump if place >= 12 else 0.0), wind=wind)
        tick = controller.tick(now.state, now.thrust, now.wind, now.time, height=now.height)
        apart, alike = compare(reference, now, tick, last)
        assert (apart < TOLERANCE, alike) == (True, True), place
        said |= {*tick.degraded_modes}
        last = tick
    assert ("clock_predicted" in said) == (jump in {5.0, -0.1, 0.3})


# --- properties ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channel", [name for name in ERRORS if name != "height"])
@pytest.mark.parametrize("duration", [0.03, 0.14])
def test_what_is_missing_is_found_at_once_and_leaves_nothing(channel, duration):
    """The mode is said in each tick without measurement, and in no other one."""
    changes = {"simulator.duration": 0.6, "disturbances.outages": [outage(channel, "missing", 0.195, duration)]}
    agrees, said = fly("test2", changes)
    mode = {"wind": "wind_held", "thrust": "thrust_modelled"}.get(channel, f"{channel.removeprefix('base_')}_predicted")
    assert agrees
    first = 20
    assert [tick for tick, modes in enumerate(said) if modes] == [*range(first, first + round(100.0 * duration))]
    assert set().union(*said) == {mode}


@pytest.mark.parametrize("sensor", ["base_position", "base_rotation", "base_linear_velocity", "height"])
@pytest.mark.parametrize(("period", "gaps"), [(0.0, 0.4), (0.02, 0.2), (0.05, 0.0), (0.1, 0.0)])
@pytest.mark.parametrize("kind", ["missing", "wrong", "frozen"])
def test_a_loss_is_found_in_time_at_every_rate(sensor, period, gaps, kind):
    """In its first tick, if it is frozen within 0.1 s, a height's after the 0.15 s of a gap; then in each to the end.

    Before and after it the modes are those of the flight without it: nothing remains.
    """
    channel = "base_velocity" if "velocity" in sensor else sensor
    mode = "ground_held" if sensor == "height" else f"{channel.removeprefix('base_')}_predicted"
    error = 3.0 * ERRORS[channel] if kind == "wrong" else None
    changes = {"simulator.duration": 0.7, "simulator.sensors": {sensor: {"period": period, "gaps": gaps}}}
    (agrees, said), (_, usual) = (
        fly("test2", changes | {"disturbances.outages": outages})
        for outages in ([outage(channel, kind, 0.195, 0.3, error)], [])
    )
    assert agrees
    within = 0.01 + (0.09 if kind == "frozen" else 0.0) + (0.15 if sensor == "height" else 0.0)
    first, last = 20 + round(100.0 * within) - 1, 49
    assert all(mode in modes for modes in said[first : last + 1])
    assert said[:20] == usual[:20]
    settled = last + 1 + round(100.0 * period)
    assert said[settled:] == usual[settled:]


TELLING = (
    (0.1, [outage("base_position", "wrong", 0.0, 0.005, 0.08)]),
    (0.5, [outage("base_rotation", "frozen", 0.2, 0.2)]),
    (0.6, [outage("base_position", "missing", 0.095, 0.3), outage("base_position", "wrong", 0.395, 0.2, 0.395)]),
    (0.9, [outage("base_velocity", "missing", 0.2, 0.6)]),
    (1.5, [outage("wind", "missing", 0.2)]),
    (3.3, [outage("base_position", "missing", 0.2, 3.3)]),
)
"""Durations and outages of flights in which each number of the reference decides or enters something."""


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("SAME", 6), ("SHARE", 0.2), ("FEW", 0.3), ("WIDENING", 1.1), ("FOLLOWING", 90.0), ("HOLD", 1.1)],
        *[("FADE", 2.1), ("BETWEEN", 0.2), ("BLIND", 2.9)],
    ],
)
def test_wrong_references_are_refused(name, value, monkeypatch):
    """Each number of them shows; so it would in the crate."""
    monkeypatch.setattr(channels, name, value)
    assert not all(fly("test2", {"simulator.duration": end, "disturbances.outages": out})[0] for end, out in TELLING)
