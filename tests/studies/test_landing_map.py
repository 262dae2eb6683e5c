"""The map of landings: ways with a height, speed and lean at a place, shares by cell, and what a mission reads off."""

import numpy as np
import pytest
import xarray as xr

from experiments.studies.landing_map import figure
from experiments.studies.landing_map import study as landing_map
from jax_aero import rust
from jax_aero.robot import waypoints

ASKED = landing_map.LandingMap()


@pytest.mark.parametrize(("place", "speed", "lean"), [(0, 6.0, 20.0), (1, 12.0, 0.0), (2, 6.0, -20.0), (1, 0.0, 0.0)])
def test_a_way_has_its_height_speed_and_lean_at_its_place(place, speed, lean):
    place = list(landing_map.PHASES.values())[place]
    points, time = landing_map.way(ASKED, 9.81, 2.0, speed, place)
    found = waypoints.reference(points, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    position, velocity, acceleration, _ = (
        np.array([np.interp(time, found.times, of) for of in part.T]) for part in found.com
    )
    assert position[2] == pytest.approx(2.0)
    assert velocity == pytest.approx([speed, 0.0, 0.0], abs=1e-3)
    angles = waypoints.lean(acceleration[None], np.zeros(1), 9.81)
    assert np.degrees(angles[0, 1]) == pytest.approx(lean, abs=0.05)


def test_a_chest_engine_may_stop_at_5_m_but_for_some_robots_not_at_1_m():
    asked, config = landing_map.LandingMap(robots=2), rust.load_config("robot")
    hovers = [
        landing_map.lost({**config, "mission": {"up": [[1.0, 1.0 + height / 0.75]]}}, "chest_l_jet", 9.5, height)
        for height in (1.0, 5.0)
    ]
    low, high = landing_map.landed(asked, rust.Robot(config["robot"]), hovers)
    assert low < high == 1.0


def test_the_map_is_linear_between_its_cells_and_constant_beyond():
    axes = {"lean": [20.0, 0.0, -20.0], "speed": [0.0, 10.0], "height": [1.0, 2.0]}
    share = xr.DataArray(np.zeros((3, 2, 2)), axes, tuple(axes))
    share.loc[{"lean": 0.0, "speed": 0.0, "height": 2.0}] = 1.0
    lean, speed, height = [0.0, 5.0, 0.0, 0.0], [0.0, 0.0, 2.5, 0.0], [1.5, 2.0, 2.0, 9.0]
    states = xr.Dataset({"lean": ("time", lean), "speed": ("time", speed), "height": ("time", height)})
    assert landing_map.shares_at(share, states).values == pytest.approx([0.5, 0.75, 0.75, 1.0])


def test_states_of_a_mission_are_those_in_the_air():
    config = rust.load_config(
        "robot", {"mission": {"up": [[1.0, 2.0]], "down": [[5.0, 6.0]]}, "simulator.duration": 10.0}
    )
    states = landing_map.states_of(config)
    assert 1.0 < states["time"][0] < states["time"][-1] < 10.0
    assert float(states["height"].min()) == pytest.approx(landing_map.ON_GROUND, abs=0.05)
    assert float(states["height"].max()) == pytest.approx(0.75, abs=0.05)
    assert float(abs(states["lean"]).max()) < 5.0


@pytest.mark.slow
def test_a_mission_is_outside_where_the_map_says_so(monkeypatch):
    """Arm engines land everywhere, chest engines nowhere."""

    def landed(_, __, losses):
        return np.array(["arm" in loss["disturbances"]["jets"]["failure"]["jet"] for loss in losses], dtype=float)

    monkeypatch.setattr(landing_map, "landed", landed)
    found = landing_map.compute(
        "robot", landing_map.LandingMap(missions=("leaning_8",), speeds=(6.0,), heights=(1.0, 5.0))
    )
    arm, chest = (found.summary[f"robot, {engine}"] for engine in ASKED.engines)
    assert (arm["outside by the map [s]"], arm["outside as flown [s]"], arm["land at any time [%]"]) == (
        0.0,
        0.0,
        100.0,
    )
    assert chest["outside by the map [s]"] == pytest.approx(chest["in the air [s]"], abs=0.2)
    assert 36.0 < chest["in the air [s]"] < 39.0
    assert found.summary["l_arm_jet, braking at 6 m/s"] == {"1 m [%]": 100.0, "5 m [%]": 100.0}
    assert figure.draw(found.dataset).axes
