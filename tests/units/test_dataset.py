"""Frames, mirror images, splits and the file of a dataset of force areas."""

import dataclasses
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from jax_aero.aero import dataset as ds
from jax_aero.aero.dataset import Dataset
from jax_aero.base import places
from jax_aero.body.robot import load_robot
from jax_aero.data.ironcub import JOINTS, LINKS
from tests.cfd_table import in_tunnel_axes, made_up_dataset

ROBOT = load_robot(places.ROBOT)


def made_up(postures=6, winds=20, seed=3) -> Dataset:
    """Postures in winds, with areas that mean nothing; the first posture is symmetric."""
    rng = np.random.default_rng(seed)
    shapes = rng.uniform(-40.0, 40.0, (postures, len(JOINTS)))
    shapes[0] = 0.5 * (shapes[0] + ds.mirrored_joints(shapes[0], JOINTS))
    pitch, yaw = rng.uniform(0.0, 180.0, winds), rng.uniform(-180.0, 180.0, winds)
    areas = rng.normal(scale=0.01, size=(postures * winds, len(LINKS), 3))
    named = {f"posture_{index}": shape for index, shape in enumerate(shapes)}
    facts = {"provenance": {"source": "made up"}, "checks": {"rows": float(len(areas))}}
    return made_up_dataset(named, pitch, yaw, areas, **facts)


@pytest.fixture(scope="module")
def data():
    return made_up()


def test_a_negative_zero_is_a_zero():
    joints, winds = np.zeros((2, len(JOINTS))), np.array([[0.0, 0.0, 1.0], [-0.0, 0.0, 1.0]])
    joints[1] = -0.0
    data = dataclasses.replace(made_up(postures=1, winds=2), joint_position_deg=joints, wind_b=winds)
    assert set(data.group) == set(data.family) == {0}


@pytest.mark.parametrize(
    ("pitch", "yaw", "direction"),
    [
        (90.0, 0.0, (1.0, 0.0, 0.0)),  # upright, facing the wind: the air moves backward
        (0.0, 0.0, (0.0, 0.0, -1.0)),  # prone, head upstream: from head to feet
        (180.0, 0.0, (0.0, 0.0, 1.0)),
        (90.0, 90.0, (0.0, -1.0, 0.0)),  # to the robot's left
    ],
)
def test_the_wind_blows_where_the_angles_say(pitch, yaw, direction):
    np.testing.assert_allclose(ds.wind_direction(pitch, yaw), direction, atol=1e-15)


def test_the_tunnel_frame_is_a_rotation_with_the_wind_along_x():
    rng = np.random.default_rng(0)
    pitch, yaw = rng.uniform(0, 180, 50), rng.uniform(-180, 180, 50)
    turn = ds.tunnel_from_base(pitch, yaw)
    np.testing.assert_allclose(turn @ np.swapaxes(turn, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)
    p, y = np.radians(pitch - 90.0), np.radians(yaw)
    expected = np.stack([np.cos(p) * np.cos(y), -np.sin(y), np.sin(p) * np.cos(y)], axis=1)
    np.testing.assert_allclose(ds.wind_direction(pitch, yaw), expected, atol=1e-14)


def test_drag_is_along_the_wind(data):
    along = np.einsum("nla,na->nl", data.force_area_b, data.wind_b)
    in_tunnel = in_tunnel_axes(data)
    np.testing.assert_allclose(in_tunnel[:, :, 0], along, atol=1e-15)
    # Lift is up: the vertical of the tunnel, at right angles to wind and to side.
    lengths = np.linalg.norm(data.force_area_b, axis=2)
    np.testing.assert_allclose(np.linalg.norm(in_tunnel, axis=2), lengths)


def test_the_mirror_is_its_own_inverse_and_swaps_sides(data):
    angles, areas = data.joint_position_deg, ds.mirrored_areas(data.force_area_b, LINKS)
    images = ds.mirrored_joints(angles, JOINTS)
    np.testing.assert_allclose(ds.mirrored_joints(images, JOINTS), angles)
    np.testing.assert_allclose(ds.mirrored_areas(areas, LINKS), data.force_area_b)
    left, right = LINKS.index("l_upper_arm"), LINKS.index("r_upper_arm")
    np.testing.assert_allclose(areas[:, right], data.force_area_b[:, left] * np.array([1.0, -1.0, 1.0]))
    np.testing.assert_array_equal(images[:, :3], angles[:, :3] * [1.0, -1.0, -1.0])
    np.testing.assert_array_equal(images[:, 3:7], angles[:, 7:11])


def test_mirrored_rows_keep_drag_and_lift_and_turn_side_around(data):
    both = data.add_mirror_images()
    first, second = both.take(slice(0, len(data))), both.take(slice(len(data), None))
    assert second.is_mirrored.all()
    np.testing.assert_allclose(second.wind_b, ds.wind_direction(second.pitch_deg, second.yaw_deg), atol=1e-12)
    swapped = ds.mirrored_areas(in_tunnel_axes(first), LINKS)
    np.testing.assert_allclose(in_tunnel_axes(second), swapped, atol=1e-15)
    assert both.add_mirror_images() is both


def test_rows_have_the_links_of_their_robot(data, tmp_path):
    """Links of another robot are swapped by their own names, written, and refused where a robot lacks them."""
    links = ("head", "l_foot", "r_foot")
    areas = np.arange(9.0 * len(data)).reshape(len(data), 3, 3)
    made = dataclasses.replace(data, force_area_b=areas, links=links)
    image = made.add_mirror_images().force_area_b[len(data) :]
    np.testing.assert_array_equal(image, areas[:, [0, 2, 1]] * [1.0, -1.0, 1.0])
    ds.save(made, tmp_path / "made.nc")
    own = SimpleNamespace(joint_names=JOINTS, aero_links=SimpleNamespace(names=links))
    assert ds.load(tmp_path / "made.nc", own).links == links
    with pytest.raises(ValueError, match=r"links of .*made.nc are \['head', 'l_foot', 'r_foot'\]; expected \['head', "):
        ds.load(tmp_path / "made.nc", ROBOT)
    own.joint_names = ["hinge"]
    with pytest.raises(ValueError, match=r"joints of .*made.nc are \['torso_pitch', .*; expected some of \['hinge'\]"):
        ds.load(tmp_path / "made.nc", own)
    with pytest.raises(ValueError, match="`force_area_b` has shape"):
        dataclasses.replace(data, links=links)


def test_a_posture_and_its_image_are_one_family_and_poles_are_one_group(data):
    both = data.add_mirror_images()
    assert len(np.unique(both.family)) == len(data.postures)
    for name in data.postures:
        assert len(np.unique(both.family[both.posture == name])) == 1
    poles = data.take(np.array([0, 0, 1]))
    assert poles.group[0] == poles.group[1] != poles.group[2]


def test_folds_hold_every_posture_out_once(data):
    both = data.add_mirror_images()
    folds = both.grouped_folds(seed=1, folds=3)
    assert sorted(np.concatenate([held for _, held in folds]).tolist()) == list(range(len(both)))
    for training, held in folds:
        assert sorted([*training, *held]) == list(range(len(both)))
        assert not set(both.posture[training]) & set(both.posture[held])
    with pytest.raises(ValueError, match="expected 2 to 6"):
        data.grouped_folds(seed=1, folds=7)


def test_splits_depend_on_the_seed_alone(data):
    for split in (lambda seed: data.random_split(seed, 0.2), lambda seed: data.grouped_folds(seed)[0]):
        np.testing.assert_array_equal(split(4)[1], split(4)[1])
        assert len({tuple(split(seed)[1].tolist()) for seed in range(8)}) > 2
    assert len(data.random_split(1, 0.25)[1]) == len(data) // 4


def test_a_file_gives_back_what_was_written(data, tmp_path):
    path = tmp_path / "deep" / "data.nc"
    ds.save(data.add_mirror_images(), path)
    again = ds.load(path, ROBOT)
    for name in ds.ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(data.add_mirror_images(), name))
    assert (again.provenance, again.checks) == (data.provenance, data.checks)
    assert again.sha256 == data.add_mirror_images().sha256 != data.sha256
    assert [entry.name for entry in path.parent.iterdir()] == ["data.nc"]


def test_a_file_that_is_not_there_or_is_another_one_is_refused(data, tmp_path):
    with pytest.raises(ValueError, match=r"there is no dataset .*nope\.nc; write it with: jax-aero data import-cfd"):
        ds.load(tmp_path / "nope.nc", ROBOT)
    path = tmp_path / "data.nc"
    ds.save(data, path)
    with h5py.File(path, "r+") as file:
        file["force_area_b"][3, 2, 1] += 1e-9
    with pytest.raises(ValueError, match="its numbers give"):
        ds.load(path, ROBOT)
    path.write_text("no NetCDF")
    with pytest.raises(ValueError, match="not a dataset of this project"):
        ds.load(path, ROBOT)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wind_b": np.full((120, 3), 0.4)}, "wind_b of row .* expected a unit vector"),
        ({"speed": np.full(7, 17.0)}, "`speed` has shape .7,.; expected .120,."),
        ({"pitch_deg": np.full(120, np.nan)}, "`pitch_deg` of row 0 .`posture_0`. is not finite"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(data, change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(data, **change)
