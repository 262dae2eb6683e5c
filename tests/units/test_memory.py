"""A controller and its copy that receive the same measurements stay together."""

import json

import numpy as np
import pytest

from jax_aero import backends, memory, rust
from jax_aero.base import places
from jax_aero.verify import flight as verified

STANDING = {"mk3_robot_take_off"}
"""Controllers whose copy parts from them while they stand: a list that only shrinks. None does so in the air."""

APART = {"robot_take_off", "mk3_robot_take_off"}
"""Those whose torques differ by more than `TORQUE` before the end of a mission that begins and ends on their feet."""

ELSEWHERE = {
    "robot_take_off": "robot",
    "mk3_robot_take_off": "mk3_robot",
    "robot_ideal": "test2",
    "mk3_robot_ideal": "mk3_test2",
}
"""Flights of controllers with feet in the air, and of those without an experiment."""

TORQUE = 1e-6
"""Greatest difference of the torques of a controller and its copy [N m]."""

CHOICES: dict[str, str] = {}
"""Mode that a rounding of the measurements changes, by flight, which is compared until then."""


def shipped():
    """Return a flight for every controller and robot of the experiments, and what else flies it."""
    found = {}
    for name in places.names("experiments"):
        config = rust.load_config(name)
        key = json.dumps([config["robot"], config["controller"]], sort_keys=True, default=str)
        found.setdefault(key, (name, config))
    flights = dict(found.values())
    for name, flight in ELSEWHERE.items():
        flights[f"{name} in {flight}"] = {**rust.load_config(flight), "controller": rust.load_controller(name)}
    return flights


SHIPPED = shipped()


def test_every_controller_has_a_flight():
    """By what identifies it: its configuration, with the numbers of its robot."""
    flown = [config["controller"] for config in SHIPPED.values()]
    for name in places.names("control"):
        assert rust.load_controller(name) in flown, name


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_controller_keeps_its_copy(name):
    """It hovers, or stands; one that does not is listed."""
    found = memory.growth(SHIPPED[name])
    assert found.stays == (name not in STANDING), found


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_flight_replayed_from_rounded_measurements_has_its_torques(name):
    """To its end, every measurement times 1 + 1e-15 N(0, 1): none of a robot that hovers is an exception."""
    config, rng = SHIPPED[name], np.random.default_rng(0)
    log = backends.backend(backends.backend_of(config)).fly(config).log
    near = {signal: rows * (1.0 + 1e-15 * rng.normal(size=rows.shape)) for signal, rows in log.items()}
    copy = rust.replay(config, {**log, **{signal: rows for signal, rows in near.items() if signal.startswith("raw_")}})
    changed = copy["degraded_modes"].astype(int) ^ log["degraded_modes"].astype(int)
    until = int(np.argmax([*(changed != 0), True]))
    apart = np.abs(copy["joint_torque"] - log["joint_torque"])[:until].max(initial=0.0)
    modes = [mode for mode, bit in rust.MODES.items() if until < len(changed) and changed[until] & bit]
    if name not in APART:
        assert modes == [CHOICES[name]] if name in CHOICES else not modes
    assert (apart <= TORQUE) == (name not in APART), apart


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mk3_robot", "mk3_design"])
def test_verify_can_compare_every_tick_with_each_side_keeping_its_own_memory(name):
    """To the end: no detector acts, and the crate's own replay from rounded measurements is the flight."""
    config = rust.load_config(name)
    crate = rust.fly(config)
    replayed = verified._replay_rounded(config, crate)
    assert verified.ticks_unguarded(crate) == len(crate["time"])
    assert verified.ticks_reproducible(crate, replayed) == len(crate["time"])


@pytest.mark.parametrize(
    ("setting", "stays"),
    [
        ({"controller.estimator.joint_observer": 0.02, "controller.disturbance_observer.gain_force": 3.0}, False),
        ({"controller.estimator.joint_observer": 0.05, "controller.disturbance_observer.gain_force": 3.0}, True),
        ({"controller.estimator.joint_observer": 0.02, "controller.disturbance_observer.gain_force": 2.0}, True),
    ],
)
def test_the_observers_of_joints_and_force_decide(setting, stays):
    """iRonCub-Mk3: 1.014 a tick at 0.5 Hz is ten times in 1.65 s, as a replay of its log parts from it."""
    found = memory.growth(rust.load_config("mk3_robot", setting))
    assert found.stays == stays
    if not stays:
        assert found.greatest == pytest.approx(1.014, abs=0.002)
        assert found.frequency == pytest.approx(0.5, abs=0.1)
        assert "tenfold in 1." in str(found)


@pytest.mark.parametrize("growth", [0.98, 1.0, 1.014])
def test_eigenvalues_are_those_of_the_map(growth):
    """A rotation by 0.03 rad a tick that grows, beside a mode that decays, seen by three numbers of four states."""
    turn = growth * np.array([[np.cos(0.03), -np.sin(0.03)], [np.sin(0.03), np.cos(0.03)]])
    tick = np.block([[turn, np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([0.9, 0.3])]])
    seen, state, ticks = np.random.default_rng(1).normal(size=(3, 4)), np.array([1.0, 0.0, 5.0, 5.0]), []
    for _ in range(400):
        ticks.append(seen @ state)
        state = tick @ state
    found = memory.eigenvalues([np.array(ticks)])
    assert abs(found[0]) == pytest.approx(growth, abs=1e-6)
    assert abs(np.angle(found[0])) == pytest.approx(0.03, abs=1e-6)


def test_what_has_no_memory_has_no_growth():
    assert memory.growth(rust.load_config("platform_hover")).greatest == 0.0
