"""Speeds from which losses are landed: the optimum, its flights, and what is drawn of them."""

import numpy as np
import pytest
import xarray as xr

from experiments.studies.height_lost import study as height_lost
from experiments.studies.landing_speed import figure
from experiments.studies.landing_speed import study as landing_speed
from jax_aero import rust
from jax_aero.base import places

ASKED = landing_speed.LandingSpeed(heights=(1.0, 3.0), engines=("l_arm_jet",), robots=1, halvings=2)


def test_the_fastest_sink_ends_at_the_limit_of_a_landing_and_more_height_allows_more():
    hover = rust.load_config("robot", {"mission": {}, **landing_speed.WIND})
    search = height_lost.HeightLost(reaction=0.08, intervals=4)
    sink = landing_speed.Sink(search, hover, 3.0, "l_arm_jet")
    low, high = sink.fastest(1.0), sink.fastest(3.0)
    # With all engines at rest a fall of 1 m ends at 4.4 m/s, and nothing may be faster than 1.5 m/s at the end.
    assert -1.0 < low < high < 3.0


def test_a_flight_sinks_at_its_speed_and_height_when_its_engine_stops():
    config = landing_speed.sinking(rust.load_config("robot"), "l_arm_jet", 2.0, 0.5)
    config["simulator"]["duration"] = landing_speed.LOSS
    log = rust.fly(config).log
    height = log["com_position"][-1, 2] - log["com_position"][0, 2] - config["simulator"]["ground_height"]
    assert height == pytest.approx(2.0, abs=0.05)
    assert log["com_velocity"][-1, 2] == pytest.approx(-0.5, abs=0.05)
    assert log["wind"][-1] == pytest.approx([0.0, -10.0, 0.0])


@pytest.mark.parametrize(("edge", "expected"), [(-1.0, np.nan), (0.0, 0.0), (0.9, 0.8), (9.0, 1.2)])
def test_the_search_finds_an_edge_to_a_fourth_of_its_range(monkeypatch, edge, expected):
    def landed(_, __, flights):
        return np.array([float(flights[0]["controller"]["setpoint"]["speed"][1] <= edge)])

    monkeypatch.setattr(landing_speed.landing_map, "landed", landed)
    found = landing_speed.flown(ASKED, rust.load_config("robot"), "l_arm_jet", 2.0)
    assert found == pytest.approx(expected, nan_ok=True)


def test_the_price_is_that_of_the_slow_way():
    """2.5 m at 0.2 m/s in place of 0.75 m/s are 9.2 s; from 0.75 m/s the last 5 cm take 0.6 s more."""
    mission = {"mission": {"up": [[0.5, 5.5]], "down": [[6.0, 11.0]]}, "simulator.duration": 13.0}
    fast = rust.load_config("robot", mission)
    slow = rust.set_keys(fast, {"mission.down": [], "mission.land": [[6.0, 21.0]], "simulator.duration": 23.0})
    found = landing_speed.price(fast, slow)
    assert found["longer [s]"] == pytest.approx(8.6, abs=0.1)
    per_second = found["more fuel [l]"] / found["longer [s]"]
    assert 0.01 < per_second < 0.1


def test_the_landing_whose_price_is_stated_is_that_of_the_mission():
    given = {"mission": {"base": str(places.find("mission", "landing"))}}
    assert rust.load_config("robot", given)["mission"]["land"] == landing_speed.LANDING


def test_the_drawn_landing_is_that_of_the_mission():
    landing = landing_speed.landing(rust.load_config("robot"))
    low = landing["landing_speed"].where(landing["landing_height"] < 2.5 - 1e-9, drop=True)
    assert low.size > 300
    assert low.values == pytest.approx(0.2)
    assert float(landing["landing_speed"].max()) == pytest.approx(0.75)
    axes = {"engine": ["l_arm_jet"], "height": [1.0, 3.0], "of": ["optimum", "flown"]}
    data = xr.Dataset({"speed": (tuple(axes), np.array([[[0.4, np.nan], [1.1, 0.9]]]))}, axes).merge(landing)
    lines = figure.draw(data).axes[0].get_lines()
    assert list(lines[0].get_ydata()) == [0.4, 1.1]
