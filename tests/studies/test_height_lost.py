"""Height lost after an engine stops: the engine, what ends a fall, and the fall of a robot in few intervals."""

import casadi as ca
import jax
import numpy as np
import pytest

from experiments.studies.height_lost import fall as falls
from experiments.studies.height_lost import sink as sinks
from experiments.studies.height_lost import study as height_lost
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.body import jets

ASKED = height_lost.HeightLost(intervals=4)


@pytest.fixture(scope="module")
def fall():
    return height_lost.Fall(ASKED, rust.load_config("robot"), ASKED.time, "chest_l_jet")


def test_an_engine_is_that_of_the_twin_and_scales_in_time_and_thrust(agree):
    k = tables.read(ROBOT)["engines"]["P160"]
    engine = jets.Engines(**{name: np.array([float(k[name])]) for name in jets.Engines._fields})
    with jax.enable_x64(True):
        expected = jets.thrust_acceleration(engine, np.array([80.0]), np.array([12.0]), np.array([60.0]))
    found = falls._acceleration(k, 2 * 80.0, 2 * 12.0 / 3.0, falls._input(k, 60.0), ca.DM([3.0, 2.0]))
    agree("acceleration", float(found), 2.0 / 9.0 * float(expected[0]), 1e-12)


def test_without_reaction_it_falls_and_turns(fall):
    """A chest engine carried a fourth of the weight; the arms of the others turn it."""
    assert -0.5 < fall.start[falls.DOWNWARDS] < 0.24
    assert 0.02 < np.abs(fall.start[falls.TURN][:2]).max() < 0.2
    assert abs(fall.start[14]) < 1e-12


def test_weak_engines_end_no_fall(fall):
    assert fall.greatest_acceleration(1.0) > 1.0
    assert fall.solve(1.0, 0.7)[0].height != fall.solve(1.0, 0.7)[0].height


@pytest.mark.slow
def test_a_fall_ends_within_the_limits_of_a_landing(fall):
    landing, found = fall.solve(1.0, 1.0)
    path = found[: fall.size * 5].reshape(5, fall.size)
    assert 0.5 < landing.height < 4.0
    assert path[-1, falls.DOWNWARDS] >= -falls.DOWNWARDS_MAX - 1e-6
    assert float(fall.upright(path[-1])) >= np.cos(falls.LEAN_MAX) - 1e-6


@pytest.mark.slow
def test_strong_and_fast_engines_lose_no_height_and_gain_none(fall):
    """Where climbing first is allowed the end is 168 m above the start."""
    _, found = fall.solve(1.0, 1.0)
    landing, _ = fall.solve(0.1, 2.0, found)
    assert 0.0 <= landing.height < 0.1


@pytest.mark.slow
def test_a_touchdown_is_on_the_ground_and_within_what_the_flight_reaches():
    """From 1 m without any thrust it is 4.4 m/s."""
    flight, time = height_lost.losses_of(ASKED, rust.load_config("robot"))["hover at 1 m"]
    fall = height_lost.Fall(ASKED, flight, time, "chest_l_jet")
    assert fall.height - fall.ground == pytest.approx(1.0, abs=0.05)
    found = fall.touch_down()
    assert 1.0 < found.downwards < 3.0
    assert found.sideways < 1.0
    assert found.lean <= found.steepest < 60.0
    assert 0.6 < found.duration < 2.0


def test_a_flown_touchdown_is_that_of_the_flight():
    flight, time = height_lost.losses_of(ASKED, rust.load_config("robot"))["hover at 1 m"]
    found = height_lost.touched(flight, "chest_l_jet", time)
    assert 1.5 < found.downwards < np.sqrt(2 * 9.81)
    assert found.duration < 2.0
    assert 0.0 < found.lean <= found.steepest


def test_the_fastest_descent_that_is_flown_is_found_by_bisection(monkeypatch):
    """Robots that land below 0.5 m/s: bisection finds 0.45; there is no speed where not even a hover is landed."""

    class Flown:
        def __init__(self, speed, limit):
            self.outcome = "landed" if speed < limit else "crashed"

    def flying(limit):
        def fly_batch(configs):
            assert len(configs) == asked.robots
            return [Flown(config["controller"]["setpoint"]["speed"][1], limit) for config in configs]

        return fly_batch

    asked, config = falls.HeightLost(robots=2, speed_max=1.6, halvings=5), rust.load_config("robot")
    monkeypatch.setattr(rust, "fly_batch", flying(0.5))
    assert sinks.flown(asked, config, "l_arm_jet", 1.0) == pytest.approx(0.45)
    monkeypatch.setattr(rust, "fly_batch", flying(0.0))
    assert np.isnan(sinks.flown(asked, config, "l_arm_jet", 1.0))


def test_a_sinking_robot_loses_its_engine_at_the_height():
    config = sinks.sinking(rust.load_config("robot"), "l_arm_jet", 1.0, 0.4)
    log = rust.fly(config).log
    at_loss = np.searchsorted(log["time"], sinks.LOSS)
    above = log["com_position"][at_loss, 2] - log["com_position"][0, 2] - config["simulator"]["ground_height"]
    assert above == pytest.approx(1.0, abs=0.05)
    assert log["com_velocity"][at_loss, 2] == pytest.approx(-0.4, abs=0.05)


def test_a_landing_is_slow_near_the_ground():
    way = sinks.landing(rust.load_config("robot"))
    low = way["landing_height"] < 2.4
    assert way["landing_speed"].values[low] == pytest.approx(0.2)
    assert float(way["landing_speed"].max()) == pytest.approx(0.75)
