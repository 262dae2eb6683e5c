"""Missions of waypoints: smooth, in the directions they name, refused where they are not clear, and flown."""

from pathlib import Path

import numpy as np
import pytest

from jax_aero import cli, rust
from jax_aero.base import places, tables
from jax_aero.robot import waypoints
from jax_aero.robot.waypoints import Step, Waypoints, reference
from tests.measurements import measured

EAST = np.array([1.0, 0.0, 0.0])
WAYS = {"leaning_11": 11.0, "leaning_8": 8.0, "quick_climb": 13.0}  # s


def points(*steps, **more):
    return Waypoints(experiment=places.find("experiments", "test2"), title="", steps=steps, **more)


def test_steps_go_where_they_say():
    steps = (Step(forward=4.0), Step(turn_deg=90.0), Step(left=1.0), Step(climb_to=3.0), Step(climb=-1.0))
    found = reference(points(*steps, start=2.0), np.array([1.0, 2.0, 0.5]), EAST)
    # East by 4; heading north; left of north is west; up to 3 above the start, and 1 down.
    measured("end [m]", np.abs(found.com[0, -1] - [1.0 + 4.0 - 1.0, 2.0, 0.5 + 3.0 - 1.0]).max(), 1e-12)
    assert found.heading[-1] == np.pi / 2
    assert found.times[0] == 2.0
    assert np.all(np.diff(found.times) > 0.0)


def test_a_motion_is_at_rest_at_its_ends_and_keeps_its_speed():
    found = reference(points(Step(forward=6.0, speed=2.0)), np.zeros(3), EAST)
    measured("derivatives at the end", np.abs(found.com[1:, -1]).max(), 1e-9)
    fastest = np.linalg.norm(found.com[1], axis=1).max()
    assert 0.99 * 2.0 < fastest <= 2.0 + 1e-12
    assert abs(found.times[-1] - 3.0 - 35.0 / 16.0 * 6.0 / 2.0) < 1e-12


def test_a_motion_through_one_point_has_the_least_jerk():
    """From rest to rest: `10 s³ − 15 s⁴ + 6 s⁵`; the heading turns it."""
    steps = (Step(turn_deg=90.0), Step(through=((2.0, 3.0, -1.0, 0.5),)))
    found = reference(points(*steps, start=0.0), np.array([1.0, 0.0, 0.0]), EAST)
    s = (found.times[-9:] - found.times[-9]) / 2.0
    rise = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    shift = np.array([1.0, 3.0, 0.5])  # right of north is east
    for order in range(3):
        expected = rise.deriv(order)(s) / 2.0**order if order else rise(s)
        there = found.com[order, -9:] - (np.array([1.0, 0.0, 0.0]) if order == 0 else 0.0)
        measured(f"derivative {order}", np.abs(there - expected[:, None] * shift).max(), 1e-12)


def test_a_motion_through_points_passes_them_smoothly():
    way = ((2.0, 1.0, 0.0, 0.0), (3.0, 1.0, 1.0, 0.5), (6.0, 0.0, 0.0, 0.0))
    found = reference(points(Step(through=way), start=0.0), np.zeros(3), EAST)
    for time, *place in way:
        measured("distance from the point", np.abs(found.com[0, found.times == time] - place).max(), 1e-12)
    measured("speed and acceleration at the end", np.abs(found.com[1:3, -1]).max(), 1e-12)
    step = found.times[1]
    jumps = np.abs(np.diff(found.com[3, 1:], axis=0)).max()
    assert jumps < 10.0 * step  # of the jerk, which is continuous


@pytest.mark.parametrize(
    ("step", "words"),
    [
        *(
            ({"through": [[time, 0.0, 0.0, 1.0] for time in times]}, r"`steps\[1\].through` is .*; expected times > 0")
            for times in ((0.0, 1.0), (2.0, 2.0), (3.0, 1.0))
        ),
        *((step, r"`steps\[1\]` is .*; expected one motion") for step in ({}, {"forward": 1.0, "climb": 1.0})),
    ],
)
def test_an_unclear_step_and_times_that_do_not_grow_are_refused(step, words):
    table = {"experiment": places.find("experiments", "test2"), "title": "", "steps": [{"hold": 1.0}, step]}
    with pytest.raises(ValueError, match=f"a.toml: {words}"):
        tables.convert(table, Waypoints, "a.toml")


@pytest.mark.parametrize(
    ("name", "fastest"), [("mk3_min_jerk", 0.9375), *((name, 1.875 * 78.0 / time) for name, time in WAYS.items())]
)
def test_a_shipped_mission_is_the_one_of_its_waypoints(name, fastest, tmp_path):
    assert cli.main(["robot", "waypoints", name, "--out", str(tmp_path)]) == 0
    written, shipped = (
        np.loadtxt(path, delimiter=",", skiprows=2)
        for path in (tmp_path / name / "mission.csv", places.CONFIGS / "mission" / f"{name}.csv")
    )
    measured("difference", np.abs(written - shipped).max(), 1e-8)
    speed = np.linalg.norm(shipped[:, 7:10], axis=1)
    assert speed.max() == pytest.approx(fastest, rel=1e-3)


def test_derivatives_are_those_of_the_positions():
    found = reference(points(Step(forward=6.0), start=0.0), np.zeros(3), EAST)
    step = found.times[2] - found.times[1]
    why = "the error of the difference quotient, step² / 6 of the derivative two orders up"
    for order, tolerance in ((0, 2e-3), (1, 6e-3), (2, 4e-2)):
        slope = (found.com[order, 3:] - found.com[order, 1:-2]) / (2 * step)
        measured(f"derivative {order + 1}", np.abs(slope - found.com[order + 1, 2:-1]).max(), tolerance, why)


def test_a_robot_that_leans_points_base_z_along_its_acceleration_less_gravity():
    acceleration, yaw = np.random.default_rng(1).normal(size=(2, 9, 3)) * 5.0
    roll, pitch = waypoints.lean(acceleration, yaw[:, 0], 9.81).T
    for wanted, *rpy in zip(acceleration + np.array([0.0, 0.0, 9.81]), roll, pitch, yaw[:, 0], strict=True):
        up = rust.spatial.rotation_from_rpy(np.array(rpy))[:, 2]
        measured("angle [rad]", np.abs(up - wanted / np.linalg.norm(wanted)).max(), 1e-12)


def test_a_motion_by_nothing_takes_no_time():
    steps = (Step(forward=0.0), Step(climb_to=1.0), Step(climb_to=1.0), Step(turn_deg=0.0))
    found, without = (reference(points(*some), np.zeros(3), EAST) for some in (steps, steps[1:2]))
    assert np.array_equal(found.times, without.times)
    assert np.array_equal(found.com, without.com)


def test_a_mission_beyond_the_longest_flight_is_refused_before_it_is_sampled(tmp_path, monkeypatch):
    monkeypatch.setattr(waypoints, "reference", lambda *_: pytest.fail("sampled"))
    with pytest.raises(ValueError, match="expected at most ten million ticks"):
        waypoints.write(Path("far.toml"), points(Step(forward=1e6)), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "steps",
    [(), (Step(hold=1.0), Step(forward=1e-9, speed=1e8)), (Step(forward=1e8, speed=1e8),)],
    ids=["none", "equal times", "too far"],
)
def test_a_mission_that_cannot_be_flown_leaves_no_file(tmp_path, steps):
    with pytest.raises(ValueError, match="expected"):
        waypoints.write(Path("none.toml"), points(*steps), tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_shipped_box_is_written_and_can_be_flown(tmp_path, capsys):
    assert cli.main(["robot", "waypoints", "box", "--out", str(tmp_path)]) == 0
    flight = tmp_path / "box" / "box.toml"
    assert "box.toml" in capsys.readouterr().out
    config = rust.load_config(flight)
    flown = rust.fly(config)
    assert flown.outcome == "completed"
    start, end = flown["com_setpoint"][0], flown["com_setpoint"][-1]
    box = tables.load(places.find("waypoints", "box"), Waypoints)
    _, _, forward = waypoints.start_of(rust.load_config("test2"))
    left = np.array([-forward[1], forward[0], 0.0])
    measured("set-point at the end [m]", np.abs(end - start - (20.0 * forward + 10.0 * left + [0, 0, 4.0])).max(), 1e-2)
    assert np.abs(flown["com_position"][-1] - end).max() < 0.1
    assert box.steps[0].forward == 20.0


def test_a_reference_that_was_changed_is_only_replaced_on_request(tmp_path, capsys):
    words = ["robot", "waypoints", "box", "--out", str(tmp_path)]
    mission = tmp_path / "box" / "mission.csv"
    assert cli.main(words) == cli.main(words) == 0  # the same content is written again
    written = mission.read_text()
    mission.write_text("mine")
    assert cli.main(words) == cli.REFUSED
    assert f"`{mission}` is there already, with other content" in capsys.readouterr().err
    assert mission.read_text() == "mine"
    assert cli.main([*words, "--overwrite"]) == 0
    assert mission.read_text() == written
