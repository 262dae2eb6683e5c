"""The crate's evidence on engines, its findings and conditions are the reference's in every tick of drawn flights.

The controllers have no estimator, so that thrusts are those that the channels let pass.
"""

from __future__ import annotations

import numpy as np
import pytest

from jax_aero import rust
from tests.references import engines, flights
from tests.references.engines import STOPPED, WORKS, Engines

JETS = ("l_arm_jet", "r_arm_jet", "chest_l_jet", "chest_r_jet")


def config_of(changes):
    detection = rust.load_config("robot")["controller"]["fault_detection"]
    always = {
        "simulator.duration": 1.0,
        "simulator.ground_height": -3.0,
        "controller.channels.jump": True,
        "controller.fault_detection.engines": detection["engines"],
        "controller.fault_detection.unmeasured_engines": detection["unmeasured_engines"],
    }
    return rust.load_config("test2_observer", always | changes)


def fly(changes, reference=Engines):
    """Return in which tick a flight is not the reference's, or `None`, and the ticks with findings of each engine."""
    config = config_of(changes)
    return engines.follow(config, flights.fly(config), reference)


def outage(channel, kind, start, duration=None, error=None, jet=None):
    given = {"duration": duration, "error": error, "jet": jet}
    return {"channel": channel, "kind": kind, "start": start} | {k: v for k, v in given.items() if v is not None}


def failure(kind, time, jet="l_arm_jet", **others):
    return {"disturbances.jets.failure": {"jet": jet, "kind": kind, "time": time} | others}


def push(force, duration):
    return {"disturbances.pushes": [{"body": "chest", "force": [0.0, 0.0, force], "start": 0.5, "duration": duration}]}


def outages(*given):
    return {"disturbances.outages": list(given)}


GAP = outage("base_velocity", "missing", 0.5, 0.3)
SILENT = outage("thrust", "missing", 0.4, 0.3)
DEAD = outage("thrust", "wrong", 0.5, None, -110.0, "chest_r_jet")
RATES = {"simulator.sensors": {"base_linear_velocity": {"period": 0.05}, "base_angular_velocity": {"period": 0.02}}}
ARM_PUSH = {"disturbances.pushes": [{"body": "l_elbow_1", "force": [0.0, 0.0, -60.0], "start": 0.5, "duration": 0.06}]}
FLIGHTS = {
    "nothing": ({}, []),
    "a sensor that says more": (outages(outage("thrust", "wrong", 0.3, None, 40.0, JETS[3])), ["wrong_sensor"]),
    "a sensor that says less": (outages(outage("thrust", "wrong", 0.3, None, -30.0, JETS[0])), ["wrong_sensor"]),
    "a stop": (failure("off", 0.3), ["out_of_reach"]),
    "a slow stop": (failure("off", 0.3, decay=0.2), ["out_of_reach"]),
    "a stop at other rates": (failure("off", 0.4) | RATES, ["out_of_reach"]),
    "a stop with its sensor": (failure("off", 0.4) | outages(SILENT), ["missing"]),
    "a stop with a frozen sensor": (
        failure("off", 0.4) | outages(outage("thrust", "frozen", 0.3, None, None, JETS[0])),
        ["missing"],
    ),
    "a stop with its sensor at other rates": (failure("off", 0.4) | outages(SILENT) | RATES, ["missing"]),
    "a stop without momentum": (failure("off", 0.5) | outages(GAP), ["stopped_unseen", "kept"]),
    "a dead sensor without momentum": (outages(GAP, DEAD), ["stopped_unseen", "given"]),
    "two dead sensors without momentum": (outages(GAP, DEAD, DEAD | {"jet": JETS[2]}), ["wrong_sensor"]),
    "a push without sensors": (outages(SILENT) | push(-110.0, 0.06), None),
    "a push on an arm without sensors": (outages(SILENT) | ARM_PUSH, ["missing", "given"]),
}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_engines_are_what_the_reference_finds(flight):
    changes, expected = FLIGHTS[flight]
    apart, found = fly(changes)
    assert apart is None
    if expected is not None:
        assert list(dict.fromkeys(name for _, _, name in found))[: max(len(expected), 1)] == expected


def drawn(seed):
    """Return faults of up to three kinds at once: of an engine, of sensors, of the momentum, and a push."""
    rng = np.random.default_rng(seed)
    when, changes, lost = (lambda: float(rng.uniform(0.2, 0.6))), {}, []
    if rng.random() < 0.7:
        changes |= failure("off", when(), str(rng.choice(JETS)), decay=float(rng.choice([0.0, 0.1])))
    for _ in range(rng.integers(0, 3)):
        kind = str(rng.choice(["missing", "frozen", "wrong"]))
        error = float(rng.choice([-120.0, -40.0, 25.0, 60.0])) if kind == "wrong" else None
        lost.append(outage("thrust", kind, when(), rng.choice([None, 0.2]), error, str(rng.choice(JETS))))
    if rng.random() < 0.5:
        lost.append(outage("base_velocity", "missing", when(), float(rng.choice([0.1, 0.25, 0.4]))))
    if rng.random() < 0.4:
        changes |= push(float(rng.uniform(-150.0, 150.0)), 0.1)
    if rng.random() < 0.4:
        changes |= RATES
    return changes | outages(*lost)


@pytest.mark.parametrize("seed", range(16))
def test_drawn_faults_are_found_as_the_reference_finds_them(seed):
    assert fly(drawn(seed))[0] is None


def of_three_ticks(*given):
    judge = Engines(*given)
    judge.most *= 1.01
    return judge


def test_wrong_references_are_refused(monkeypatch):
    """Each number shows in one of these flights; so it would in the crate."""
    names = ("a stop", "a stop with its sensor", "a dead sensor without momentum", "a push on an arm without sensors")
    faulty = [FLIGHTS[name][0] for name in (*names, "a stop without momentum", "a sensor that says less")]
    assert any(fly(changes, of_three_ticks)[0] for changes in faulty)
    wrong = {"FORGETTING": 0.6, "RESIDUAL": 0.03, "UNMODELLED": 1.1, "OUTSIDE": 0.04, "UNSEEN": 0.17}
    wrong |= {"SHOWN": 0.04, "NOT_SHOWN": 0.12, "SILENT": 0.2, "MISSING": 0.04, "HELD": 0.1, "OF_THRUST": 2.0}
    wrong |= {"OF_MISSING": 1.2, "LEAST_COSINE": 0.9999}
    for name, value in wrong.items():
        with monkeypatch.context() as patch:
            patch.setattr(engines, name, value)
            assert any(fly(changes)[0] for changes in faulty), name


# --- properties ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jet", range(4))
@pytest.mark.parametrize("period", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("has_sensor", [True, False])
def test_a_stop_is_found_in_time(jet, period, has_sensor):
    """Within 0.1 s and two measurements, with its sensor or without, at every rate of the base; no other engine is."""
    sensors = {f"base_{name}": {"period": period} for name in ("linear_velocity", "angular_velocity")}
    changes = failure("off", 0.4, JETS[jet]) | {"simulator.duration": 0.6}
    changes |= {"simulator.sensors": sensors} if period else {}
    changes |= {} if has_sensor else outages(outage("thrust", "missing", 0.4, None, None, JETS[jet]))
    apart, found = fly(changes)
    assert apart is None
    assert {of for _, of, _ in found} == {jet}
    assert found[0][2] == ("out_of_reach" if has_sensor else "missing")
    assert 0.01 * found[0][0] - 0.4 <= 0.1 + 2.0 * period


def test_nothing_remains_of_a_stop_that_is_given_back():
    """Condition, range and use of the sensor are those of before, and modes; the descent's from the next tick on."""
    config = config_of(FLIGHTS["a push on an arm without sensors"][0])
    flight, states = rust.Flight(config), []
    while not flight.has_ended:
        flight.step()
        states.append(flight.controller_state.engines() | {"modes": {*flight.last.degraded_modes}})
    stopped = [tick for tick, now in enumerate(states) if (now["state"] == STOPPED).any()]
    assert stopped == [*range(stopped[0], stopped[-1] + 1)]
    after = states[stopped[-1] + 1]
    assert (after["state"] == WORKS).all()
    assert after["is_sensor_used"].all()
    assert np.array_equal(after["reaches"], states[0]["reaches"])
    assert not {"engine_stopped", "engine_limited"} & after["modes"]
    assert not any("descending" in now["modes"] for now in states[stopped[-1] + 2 :])
