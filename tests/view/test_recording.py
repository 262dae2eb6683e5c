"""A result is read as it was written, and everything else is refused by name."""

import lzma
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from jax_aero import __main__ as commands
from jax_aero import rust
from jax_aero.base import places
from jax_aero.body import mesh
from jax_aero.view import Refused, drawing, labels, recording, web
from jax_aero.view.shapes import look_of

ROOT = places.HOME
ROBOTS = [ROOT / "configs/robot/ironcub_mk1.toml", ROOT / "configs/robot/sparrow.toml"]


@pytest.fixture(scope="module")
def seen(fallen):
    return recording.read(fallen)


def test_a_result_says_how_it_ended(seen):
    flight = rust.fly(rust.load_config("test1_published"))
    assert seen.verdict == f"fell at {flight.lost_time:.1f} s ({flight.lost_reason})"
    np.testing.assert_array_equal(seen.signals["aero_force_sim"], flight["aero_force_sim"])


def test_a_result_can_be_flown_again(seen):
    assert seen.config is not None
    again = recording.from_flight(rust.fly(seen.config), seen.config, "again")
    np.testing.assert_array_equal(again.signals["base_position"], seen.signals["base_position"])


def test_a_moment_is_the_pose_of_its_sample(seen):
    k = 1234
    s = seen.signals
    state = rust.State(
        s["base_position"][k],
        rust.rotation_from_wxyz(s["base_quaternion"][k]),
        s["joint_position"][k],
        np.zeros(6 + s["joint_position"].shape[1]),
    )
    pose = rust.dynamics(seen.robot, state)
    now = seen.at(s["time"][k])
    np.testing.assert_allclose(now.body_positions, pose.body_positions, atol=1e-9)
    np.testing.assert_allclose(now.body_rotations, pose.body_rotations, atol=1e-9)
    np.testing.assert_allclose(pose.com_position, s["com_position"][k], atol=1e-9)


def test_between_two_samples_lies_their_blend(seen):
    t = seen.signals["time"]
    now, first, second = seen.at(0.5 * (t[900] + t[901])), seen.at(t[900]), seen.at(t[901])
    np.testing.assert_allclose(now.com, 0.5 * (first.com + second.com), atol=1e-12)
    np.testing.assert_allclose(now.body_rotations, 0.5 * (first.body_rotations + second.body_rotations), atol=1e-4)
    np.testing.assert_allclose(now.body_rotations[0] @ now.body_rotations[0].T, np.eye(3), atol=1e-12)


def test_a_result_without_a_sample_is_refused(fallen, tmp_path):
    with xr.open_dataset(fallen / "run.nc", engine="h5netcdf") as flight:
        flight.isel(time=slice(0)).to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with pytest.raises(Refused, match="holds no sample"):
        recording.read(tmp_path)


def test_outside_the_flight_is_its_end(seen):
    assert seen.at(1e6).time == seen.duration
    assert seen.at(-1.0).time == 0.0


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_jets_and_links_are_drawn_where_the_crate_has_them(path):
    robot = rust.Robot(path)
    look = look_of(robot, path)
    rng = np.random.default_rng(3)
    limits = np.array(robot.joint_limits)
    joints = rng.uniform(limits[:, 0], limits[:, 1])
    turn = rust.rotation_from_wxyz(rng.normal(size=4))
    state = rust.State(rng.normal(size=3), turn, joints, np.zeros(6 + joints.size))
    pose = rust.dynamics(robot, state)
    assert [jet.name for jet in look.jets] == robot.jet_names
    assert [link.name for link in look.links] == robot.aero_link_names
    for mount in (*look.jets, *look.links):
        at = pose.body_positions[mount.body] + pose.body_rotations[mount.body] @ mount.position
        assert np.linalg.norm(at - pose.com_position) < 1.5
    if robot.name != "iRonCub-Mk1":
        return
    tick = rust.Controller(rust.load_config("test1")).tick(state, [100.0] * 4, np.zeros(3))
    exhaust = [pose.body_rotations[jet.body] @ jet.axis for jet in look.jets]
    nozzles = [pose.body_positions[jet.body] + pose.body_rotations[jet.body] @ jet.position for jet in look.jets]
    centres = [pose.body_positions[link.body] + pose.body_rotations[link.body] @ link.position for link in look.links]
    np.testing.assert_allclose(exhaust, -tick.jet_axes, atol=1e-9)
    np.testing.assert_allclose(nozzles, tick.jet_points, atol=1e-9)
    np.testing.assert_allclose(centres, tick.link_arm_points, atol=1e-9)


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_every_primitive_of_the_urdf_is_drawn(path):
    robot = rust.Robot(path)
    drawn = [shape for shape in look_of(robot, path).shapes if shape.role != "strut"]
    assert len(drawn) == robot.urdf_text.count("<visual>") > 5
    assert {"shell", "engine"} <= {shape.role for shape in drawn}


def test_arrows_are_as_long_as_the_legend_says(seen):
    now = seen.at(18.0)
    ends = drawing.force_arrows(look_of(seen.robot, seen.robot_path), now)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    np.testing.assert_allclose(lengths, 0.15 * np.linalg.norm(now.aero_force, axis=1), atol=1e-12)
    assert lengths.max() > 0.1
    assert 0.3 < 160.0 * drawing.SCALES["thrust"] < 1.0  # the jet of the strongest thrust, beside a robot of 1 m
    arrow = drawing.wind_arrow(now)
    assert arrow is not None
    np.testing.assert_allclose(arrow[1] - arrow[0], [0.0, -0.8, 0.0], atol=1e-12)
    assert drawing.wind_arrow(seen.at(0.0)) is None


@pytest.mark.parametrize(
    ("make", "low", "high"),
    [
        (mesh.box, (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)),
        (lambda: mesh.revolve([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 1.0)]), (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)),
    ],
)
def test_meshes_have_their_size_are_closed_and_face_outwards(make, low, high):
    vertices, faces = make()
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], [low, high], atol=0.02)  # of a polygon
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    assert np.linalg.norm(normals.sum(axis=0)) < 1e-9
    middle = vertices.mean(axis=0)
    assert np.all(np.einsum("fi,fi->f", normals, (a + b + c) / 3.0 - middle) > 0.0)


class Drawn:
    """What is drawn and written on a picture, in place of the picture."""

    def __init__(self):
        self.lines, self.words = [], []

    def line(self, points, **_):
        self.lines.append(points)

    def text(self, _, words, anchor="la", **__):
        self.words.append((words, anchor))

    def rounded_rectangle(self, *_, **__):
        pass


def test_a_profile_has_both_axes_and_their_numbers(seen):
    drawn = Drawn()
    labels.profile(drawn, (50, 20, 450, 220), seen, [1.0, 2.0], 12)
    across, up = drawn.lines[:2]
    assert across[:2] == up[:2] == (50, 220)
    assert across[3] == 220, "horizontal"
    assert 50 < across[2] <= 450, "as long as the path, or half as long as the other"
    assert up[2:] == (50, 20)
    for anchor in ("ma", "rm"):  # below the axis, and left of it
        assert sum(at == anchor and words.endswith(" m") for words, at in drawn.words) >= 2


def test_marks_at_one_place_are_one(seen):
    drawn = Drawn()
    labels.profile(drawn, (50, 20, 450, 220), seen, [1.0, 1.01, 19.0], 12)
    assert [words for words, at in drawn.words if at == "mm"] == ["1, 2", "3"]


def test_a_frame_says_what_flies_and_whose_ghost(seen, monkeypatch):
    words = []
    monkeypatch.setattr(labels, "text", lambda _, __, text, *___, **____: words.append(text))
    ghost = replace(seen, title="another")
    labels.letter_video(np.zeros((340, 600, 3), np.uint8), seen, 18.0, 100.0, ghost, ended=[], end=20.0)
    assert words[:3] == [seen.title, "ghost: another", "18.0 s"]


# --- refusals ---------------------------------------------------------------------------------------------------


def test_a_wrong_file_is_refused_by_name(tmp_path, capsys):
    text = tmp_path / "notes.nc"
    text.write_text("no NetCDF")
    (tmp_path / "empty").mkdir()
    for path, expected in (
        (tmp_path / "nowhere", "there is no `"),
        (text, "is damaged"),
        (tmp_path / "empty", "holds no run.nc"),
    ):
        for part in ([], ["video"], ["snapshot"]):
            assert commands.main(["view", *part, str(path)]) == 2
            said = capsys.readouterr().err
            assert expected in said
            assert str(path) in said
            assert "jax-aero fly" in said


def test_a_file_of_something_else_is_refused(tmp_path):
    xr.Dataset({"time": ("time", [0.0, 1.0])}).to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with pytest.raises(Refused, match=r"run\.nc` has no `base_position`"):
        recording.read(tmp_path)


@pytest.mark.slow
def test_a_result_without_its_robot_asks_for_it(made_up_results):
    folder = made_up_results / "flight" / "test1"
    with pytest.raises(Refused, match="--robot FILE"):
        recording.read(folder)
    assert recording.read(folder, ROBOTS[0]).config is None
    with pytest.raises(Refused, match=r"`joint_position` .* expected \(\d+, 5\) for robot `sparrow`"):
        recording.read(folder, ROBOTS[1])


def test_three_results_are_one_too_many(fallen, capsys):
    assert commands.main(["view", *[str(fallen)] * 3]) == 2
    assert "at most two" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["--port", "99999"], "port is 99999"), (["--host", "203.0.113.1"], "cannot listen on `203.0.113.1`")],
)
def test_an_address_that_is_none_is_refused(words, expected, capsys):
    assert commands.main(["view", *words]) == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("as_companion", [False, True])
def test_a_page_contains_no_file_that_a_stranger_names(as_companion, fallen, tmp_path, monkeypatch):
    """A card of a result may be any file: it is in the page from the result's own folder, not from another one."""
    monkeypatch.setattr(web, "SIMULATOR", tmp_path / "simulator")
    web.SIMULATOR.write_bytes(lzma.compress(b""))
    (tmp_path / "secret.json").write_text('{"of": "another folder"}')
    (tmp_path / "result").mkdir()
    own, link = (tmp_path / "result" / name for name in ("card.json", "link.json"))
    own.write_text('{"weights": {"file": "../secret.json"}}')
    link.symlink_to(tmp_path / "secret.json")
    named = own if as_companion else tmp_path / "secret.json"
    found = set()
    for path in (named, link):
        config = rust.set_keys(recording.read(fallen).config, {"simulator.aero.card": str(path)})
        table = web.simulator_table(config, False, [places.CONFIGS, tmp_path / "result"])
        found |= table["files"].keys() | table["binary"].keys()
    assert not any("secret" in name or "link" in name for name in found)
    assert any(name.endswith("card.json") for name in found) == as_companion
    assert any(name.endswith("mission/hover.toml") for name in found)


@pytest.mark.parametrize(
    ("words", "part"),
    [(["view"], "TEMPLATE"), (["view"], "SIMULATOR"), (["export", "--html", "--out", "a.html", "{}"], "TEMPLATE")],
)
def test_a_page_that_is_not_built_is_named(words, part, fallen, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("TEMPLATE", "SIMULATOR"):
        monkeypatch.setattr(web, name, tmp_path.parent / f"{name}.xz")
        getattr(web, name).write_bytes(lzma.compress(b""))
    monkeypatch.setattr(web, part, tmp_path / "missing")
    assert commands.main([word.format(fallen) for word in words]) == 2
    assert "`make lab` builds it" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_is_named_with_its_extra(monkeypatch, fallen, capsys):
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert commands.main(["view", str(fallen)]) == 2
    assert "of the extra `view`: " in capsys.readouterr().err


def test_the_library_needs_nothing_of_the_viewer():
    code = (
        "import sys, jax_aero, jax_aero.__main__, jax_aero.commands.view, jax_aero.view.web;"
        "print({'mujoco', 'av', 'PIL', 'jax', 'h5py', 'playwright'} & set(sys.modules))"
    )
    answer = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "set()"


@pytest.mark.parametrize(
    ("engines", "words"), [([], ""), ([2], "1 of 4 engines stopped"), ([0, 3], "2 of 4 engines stopped")]
)
def test_a_picture_says_how_many_engines_have_stopped(engines, words, standing):
    now = standing(rust.load_config("test2")["robot"]).at(1.0)
    thrust = now.thrust.copy()
    thrust[engines] = 0.5
    assert labels.stopped(now._replace(thrust=thrust)) == words


def test_a_picture_of_several_flights_says_why_one_is_lost(standing):
    flight = standing(rust.load_config("test2")["robot"])
    assert labels.errors(flight.at(1.0)) == "error 0°, 0.0 m"
    flight.signals["com_setpoint"][:, 0] += 0.5
    flight.signals["rotation_error"][:] = np.deg2rad(45.0)
    assert labels.errors(flight.at(1.0)) == "error 45°, 0.5 m"
    lost = replace(flight, outcome="fell", lost_time=27.6, lost_reason="CoM error 1.00 m")
    assert labels._outcome(lost) == "lost: CoM error 1.00 m"
    assert labels._outcome(flight) == "completed"
