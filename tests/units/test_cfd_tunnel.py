"""Open CFD beside the wind tunnel: which points belong to a case, in which axes, and the errors of their mean."""

import dataclasses

import numpy as np
import pytest
import xarray as xr

from jax_aero.aero import dataset as ds
from jax_aero.aero.posture import total_wrench
from jax_aero.body.robot import load_robot
from jax_aero.cfd import tunnel
from jax_aero.data.import_cfd import known_postures
from jax_aero.data.ironcub import LINKS
from tests.cfd_table import made_up_dataset

ROBOT = "configs/robot/ironcub_mk1.toml"


def points_of(rows, **changes):
    """Made-up points of a wind tunnel: posture, pitch, yaw, force area in axes x backward, y right, z up, marks."""
    posture, pitch, yaw, areas, marks = zip(*rows, strict=True)
    count = len(rows)
    moments = changes.get("moments", np.full((count, 3), np.nan))
    return xr.Dataset(
        {
            "pitch": ("point", np.array(pitch)),
            "yaw": ("point", np.array(yaw)),
            "speed": ("point", np.array(changes.get("speed", [17.0] * count))),
            "force_area": (("point", "axis"), np.array(areas)),
            "moment_com": (("point", "axis"), np.array(moments)),
            "u_total": (("point", "axis"), np.tile([0.003, 0.004, 0.0], (count, 1))),
        },
        {"posture": ("point", list(posture)), "marks": ("point", list(marks))},
    )


@pytest.fixture
def cases():
    """A posture that is its own mirror image, and one that is not, in head wind: 0.01 m² along it on every link."""
    postures = {name: known_postures()[name] for name in ("hovering", "Config5")}
    load = np.broadcast_to([0.01, 0.0, 0.0], (2, len(LINKS), 3))
    return made_up_dataset(postures, np.array([90.0]), np.array([0.0]), load, couple_volume_b=load)


def test_points_beside_a_case_have_its_posture_wind_and_speed_and_no_mark(cases):
    ahead = ("hovering", 90.0, 0.5, (0.1, 0.0, 0.0), "")
    others = [
        ("Config5", 60.0, 0.0, (9.0, 0.0, 0.0), ""),
        ("hovering", 90.0, 1.1, (9.0, 0.0, 0.0), ""),
        ("hovering", 90.0, 0.0, (9.0, 0.0, 0.0), "outlier"),
        ("hovering", 90.0, 0.0, (9.0, 0.0, 0.0), "outlier, support"),
    ]
    assert [row.force_area.tolist() for row in tunnel.pair_cases(cases, points_of([ahead, *others]), np.eye(3))] == [
        [[0.1, 0.0, 0.0]]
    ]
    fast = points_of([ahead], speed=[19.0])
    assert list(tunnel.pair_cases(cases, fast, np.eye(3))) == []
    (row,) = tunnel.pair_cases(cases, points_of([(*ahead[:4], "support")]), np.eye(3))
    assert not row.is_alone


def test_points_of_the_mirrored_wind_are_mirrored_back_where_the_posture_is_its_own_image(cases):
    """Side force changes its sign, and of the moment what turns about x and z."""
    wind = dataclasses.replace(cases, wind_b=ds.wind_direction([90.0, 90.0], [20.0, 20.0]))
    twin = points_of([("hovering", 90.0, -20.0, (0.1, 0.2, 0.3), "")], moments=[(1.0, 2.0, 3.0)])
    (row,) = tunnel.pair_cases(wind, twin, np.eye(3))
    np.testing.assert_allclose(row.force_area, [[0.1, -0.2, 0.3]])
    np.testing.assert_allclose(row.moment_com, [[-1.0, 2.0, -3.0]])
    lopsided = points_of([("Config5", 90.0, -20.0, (0.1, 0.2, 0.3), "")])
    assert list(tunnel.pair_cases(wind, lopsided, np.eye(3))) == []


def test_points_are_turned_into_the_axes_of_the_robot(cases):
    """The base of iRonCub-Mk3 has x forward and y left, that of Mk1 x backward and y right, as the points."""
    mk1 = load_robot(ROBOT)
    np.testing.assert_array_equal(tunnel.axes_of(mk1), np.eye(3))
    turned = tunnel.axes_of(dataclasses.replace(mk1, forward_axis=np.array([1.0, 0.0, 0.0])))
    np.testing.assert_array_equal(turned, np.diag([-1.0, -1.0, 1.0]))
    behind = dataclasses.replace(cases, wind_b=cases.wind_b @ turned.T)
    (row,) = tunnel.pair_cases(behind, points_of([("hovering", 90.0, 0.0, (0.1, 0.2, 0.3), "")]), turned)
    np.testing.assert_allclose(row.force_area, [[-0.1, -0.2, 0.3]])


def test_side_and_lift_are_across_the_wind_of_the_tunnel(cases, agree):
    axes = ds.tunnel_from_base(60.0, 20.0)
    ours, measured = np.array([0.13, 0.05, 0.07]) @ axes, np.array([0.1, 0.02, 0.03]) @ axes
    one = dataclasses.replace(
        cases.take(slice(1)),
        wind_b=axes[:1],
        pitch_deg=np.array([60.0]),
        yaw_deg=np.array([20.0]),
        force_area_b=np.tile(ours / len(LINKS), (1, len(LINKS), 1)),
    )
    row = tunnel.Row(0, True, measured[None], np.zeros((1, 3)), np.zeros((1, 3)))
    found = tunnel.summary(tunnel.compare_cases(load_robot(ROBOT), one, [row]))
    agree("side", found["hovering 60/20: side less that in the tunnel [m2]"], 0.03, 1e-12)
    agree("lift", found["hovering 60/20: lift less that in the tunnel [m2]"], 0.04, 1e-12)
    agree("drag", found["hovering 60/20: drag, relative error"], 0.3, 1e-12)


def test_errors_beside_the_tunnel_are_of_the_mean_of_its_points(cases, tmp_path, agree):
    """Links push with 0.13 m² in all; the points with 0.10 m², and 0.02 across on one of two."""
    points = points_of(
        [("hovering", 90.0, 0.0, (0.1, 0.04, 0.0), ""), ("hovering", 90.0, 0.2, (0.1, 0.0, 0.0), "")],
        moments=np.zeros((2, 3)),
    )
    points.to_netcdf(tmp_path / "points.nc", engine="h5netcdf")
    ds.save(cases, tmp_path / "dataset.nc")
    config = tunnel.TunnelConfig(tunnel=tmp_path / "points.nc", dataset=tmp_path / "dataset.nc")
    found = tunnel.compute("small", config).summary
    assert found["robot alone: cases"] == 1
    assert "support in the wind: cases" not in found
    assert found["robot alone: drag, relative error, rms, goal of 0.1"] == "missed, 3 times that"
    agree("drag", found["robot alone: drag, relative error, rms"], 0.3, 1e-12)
    agree("force", found["robot alone: total force, rms [m2]"], np.hypot(0.03, 0.02), 1e-12)
    # The links' forces at their centres, and their couples of 0.01 m³ each.
    robot = load_robot(ROBOT)
    load = total_wrench(robot, cases.joint_position(robot)[:1], cases.force_area_b[:1])
    volume = load.moment_volume[0] + cases.couple_volume_b[0].sum(axis=0)
    agree("moment", found["robot alone: moment, rms [N m at 10 m/s]"], 61.25 * np.linalg.norm(volume), 1e-12)
    deviation = found["hovering 90/0: moment, standard deviation of the tunnel's [N m at 10 m/s]"]
    agree("deviation", deviation, 61.25 * 0.005, 1e-12)
