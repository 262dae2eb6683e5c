"""Models beside the tunnel's moments, and the matrix of pairs: what they compute."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from experiments.studies.tunnel_moments import figure
from experiments.studies.tunnel_moments import study as tunnel_moments
from jax_aero.aero import dataset
from jax_aero.aero.posture import link_axes, rms_by_posture, total_wrench
from jax_aero.base import tables
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import load_robot
from jax_aero.cfd import models
from jax_aero.data import import_tunnel, tunnel
from jax_aero.data.fit import predicted_areas
from jax_aero.data.ironcub import joint_position
from jax_aero.figures import model_pairs
from tests.units.test_tunnel import clone, gvp


@pytest.fixture(scope="module")
def robot():
    return load_robot(tunnel_moments.ROBOT)


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    load = (-20.0, 3.0, 1.0, -0.5, -1.5, 0.3)
    files = {
        "TID_0001.GVP": gvp([(1, 0.0, 0.0, 12.0, 85.0, load), (2, 0.0, 20.0, 12.0, 85.0, load)]),
        "TID_0018.GVP": gvp([(1, -5.0, 0.0, 17.0, 170.0, load)]),
    }
    (found,) = import_tunnel.from_clone(clone(tmp_path_factory.mktemp("clone"), files))
    return {side: import_tunnel.reduce_moments(found, side) for side in tunnel_moments.SIDES}


def test_the_measured_moment_has_the_offset_of_its_side(points):
    for side, data in points.items():
        found = tunnel_moments.moment_about_com(points["below"], side)
        np.testing.assert_allclose(found, data["moment_com"].values, atol=1e-15)
    moved = tunnel_moments.moment_about_com(points["below"], "below", lambda *_: np.array([0.0, 0.0, 0.01]))
    turns = [tunnel.base_from_balance("mk1", kind) for kind in points["below"]["kind"].values]
    arm = np.array([turn @ [0.0, 0.0, 0.01] for turn in turns])
    expected = np.cross(arm, points["below"]["force_area"].values)
    np.testing.assert_allclose(moved - points["below"]["moment_com"].values, expected, atol=1e-15)


def test_corrected_arms_are_the_links_centres_and_published_ones_are_not_turned(robot, points):
    data = points["below"]
    areas = np.random.default_rng(1).normal(size=(3, 13, 3))
    right, published = tunnel_moments.moments(robot, data, areas)
    joints = joint_position(robot, data["joint_position"].values)
    np.testing.assert_allclose(right, total_wrench(robot, joints, areas).moment_volume, atol=1e-14)
    # The arms differ by the offset: turned with the link, or left in inertial axes.
    offsets = np.asarray(robot.aero_links.centres)
    for point, pitch in enumerate(data["pitch"].values):
        frames = tunnel_moments.link_frames(robot, joints[point : point + 1])
        turned = np.einsum("lij,lj->li", frames.rotations[0], offsets)
        inertial = offsets @ dataset.tunnel_from_base(pitch, 0.0)
        more = np.cross(inertial - turned, areas[point]).sum(axis=0)
        np.testing.assert_allclose(published[point] - right[point], more, atol=1e-14)


def test_models_are_evaluated_in_the_wind_of_the_tunnel(robot, points):
    data = points["below"].isel(point=[0])
    joints, wind = data["joint_position"].values, dataset.wind_direction(data["pitch"].values, data["yaw"].values)
    settings = tables.read(models.AERO / "axisymmetric_corrected.toml")
    found = models.evaluate_areas(robot, settings, joints, 12.0 * wind)
    expected = predicted_areas(
        np.asarray(robot.aero_links.coefficients["corrected"]), link_axes(robot, joint_position(robot, joints)), wind
    )
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_postures_are_drawn_with_all_of_their_rows():
    """Errors 1 and 2 of one posture, 3 of another: draws have both postures, or one of them twice."""
    errors = np.zeros((1, 3, 3))
    errors[0, :, 1] = 1.0, 2.0, 3.0
    drawn = rms_by_posture(errors, np.array(["a", "a", "b"]), 100, 1)
    assert drawn.shape == (100, 1)
    np.testing.assert_allclose(np.unique(drawn.round(9)), np.sqrt([10.0 / 4.0, 14.0 / 3.0, 9.0]), atol=1e-9)


def test_a_model_that_is_the_measurement_has_no_error(points):
    data = points["below"]
    below = tunnel_moments.moment_about_com(data, "below")
    volumes = np.stack([np.zeros((2, 3, 3)), np.stack([below, below + 0.02])])
    errors, intervals, added = tunnel_moments.compare(data, volumes)
    np.testing.assert_allclose(errors[1, 0, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(errors[1, 1, 0], 0.02 * np.sqrt(3.0) * tunnel_moments.NEWTON_METRES, atol=1e-12)
    assert np.all(intervals[..., 0] <= intervals[..., 1])
    # Errors of the offset, of some 0.01 m, change a moment by some per cent of an area of 1 m².
    assert np.all(intervals[1, 1, 0, :, 0] < 2.0 * errors[1, 1, 0])
    assert np.all(intervals[1, 1, 0, :, 1] > 0.5 * errors[1, 1, 0])
    assert added.shape == (2, 2, 3, 3)
    assert added[1, 0, 2, 2] > 0.9


def test_figures_of_the_comparison_are_those_of_its_points(robot, points, monkeypatch, agree):
    monkeypatch.setattr(tunnel_moments, "DRAWS", 20)
    data = points["below"]
    areas = {
        name: np.full((3, 13, 3), 1e-3 * (k + 1))
        for k, name in enumerate(("axisymmetric, corrected", "network, shipped"))
    }
    result = tunnel_moments.compare_moments(robot, data, areas)
    found = tunnel_moments.summary(result)
    measured = tunnel_moments.moment_about_com(data, "above")
    alone = data["kind"].values == "hovering"
    for group, rows in (("all", slice(None)), ("hovering", alone), ("flight", ~alone)):
        own = np.sqrt(np.mean(np.sum(data["u_total"].values[rows] ** 2, axis=1)))
        agree("own", found[f"{group}: the measurement's own standard deviation [N m]"], 61.25 * own, 1e-12)
    without = np.sqrt(np.mean(np.sum(measured[alone] ** 2, axis=1)))
    agree("no model", found["hovering, centre above, no moment, corrected arms: rms [N m]"], 61.25 * without, 1e-12)
    name = "axisymmetric, corrected"
    # Arms matter to a model that has forces.
    arms = [f"hovering, centre above, {model}, published arms: rms [N m]" in found for model in (name, "no moment")]
    assert arms == [True, False]
    more = [found[f"all, centre below, {name}: published arms add, {text}"] for text in tunnel_moments.ADDED]
    assert more[0] <= more[1]
    assert 0.0 <= more[2] <= 1.0


def test_the_points_of_the_tunnel_count(tmp_path, monkeypatch):
    monkeypatch.setattr(tunnel_moments, "read", lambda _: xr.Dataset(coords={"point": [0]}))
    monkeypatch.setattr(tunnel_moments, "model_areas", lambda *_: {})
    monkeypatch.setattr(tunnel_moments, "compare_moments", lambda _, data, __: data)
    monkeypatch.setattr(tunnel_moments, "summary", lambda _: {})
    path = tmp_path / "tunnel.nc"
    config = tunnel_moments.MomentsConfig(dataset=path)
    found = tunnel_moments.compute("mk1", config)
    assert {path, tunnel_moments.ROBOT} <= {*found.files, *tables.files(config)}


def test_a_cell_of_the_matrix_counts_balanced_arrivals():
    flights = pd.DataFrame(
        {
            "world": ["a", "a", "a", "b"],
            "model": ["m"] * 4,
            "outcome": ["completed", "completed", "fell", "completed"],
            "max_rotation_error_deg": [10.0, 60.0, 20.0, 5.0],
        }
    )
    share, lean = model_pairs.matrices(flights, ["m"], ["a", "b"])
    np.testing.assert_allclose(share, [[1 / 3, 1.0]])
    np.testing.assert_allclose(lean, [[60.0, 5.0]])


def test_points_that_are_not_there_or_cut_short_are_named(tmp_path):
    with pytest.raises(Refused, match="make it with: jax-aero data import-tunnel --clone DIR"):
        tunnel_moments.read(tmp_path / "none.nc")
    (tmp_path / "tunnel_mk1.nc").write_bytes(b"\x89HDF\r\n\x1a\n cut short")
    with pytest.raises(Refused, match=r"tunnel_mk1\.nc is damaged .*; remove its folder and make it again"):
        tunnel_moments.read(tmp_path / "tunnel_mk1.nc")


def test_the_figure_shows_models_that_the_study_evaluates():
    assert figure.SHOWN.keys() <= models.MODELS.keys()
