"""Force areas beside a made-up wind tunnel in which the air is one of them and a support is exposed in side winds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr

from experiments.studies.tunnel_mk3 import study as tunnel_mk3
from jax_aero.aero.dataset import wind_direction
from jax_aero.aero.posture import axes_of, link_axes, total_wrench
from jax_aero.base.files import write_netcdf
from jax_aero.body.robot import load_robot
from jax_aero.data import fit
from jax_aero.data.import_cfd import known_postures
from jax_aero.data.import_tunnel import MK3, POSTURES_OF_MK3
from jax_aero.data.ironcub import joint_position
from tests.measurements import measured

SUPPORT = 0.05
"""Force area of the support in side winds, along them [m²]."""
PLACE = np.array([-0.2, 0.0, -0.03])
"""Its place from the centre of mass, base axes [m]."""


@pytest.fixture(scope="module")
def robot():
    return load_robot(MK3)


@pytest.fixture(scope="module")
def points(robot):
    """Points of three postures, each twice; one is in doubt."""
    known = known_postures(path=POSTURES_OF_MK3)
    hovering = itertools.product(["homePos", "hovering_config01"], ["hovering"], [90.0], range(-90, 91, 30))
    flight = itertools.product(["flight30"], ["flight"], [30.0, 60.0, 120.0], [0.0])
    posture, kind, pitch, yaw = map(np.array, zip(*(2 * [*hovering, *flight]), strict=True))
    axes, joints = axes_of(robot), np.array([known[name] for name in posture])
    wind = wind_direction(pitch, yaw) @ axes.T
    positions = joint_position(robot, joints)
    areas = fit.predicted_areas(
        np.asarray(robot.aero_links.coefficients["estimated"]), link_axes(robot, positions), wind
    )
    force, moment = total_wrench(robot, positions, areas)
    support = np.where(np.abs(yaw) > 45.0, SUPPORT, 0.0)[:, None] * wind
    marks = np.where(np.abs(yaw) > 20.5, "support", "")
    marks[0] = "moment drifted, support"
    force[0] += 9.0
    return xr.Dataset(
        {
            "pitch": ("point", pitch),
            "yaw": ("point", yaw.astype(float)),
            "joint_position": (("point", "joint"), joints),
            "force_area": (("point", "axis"), (force + support) @ axes),
            "moment_com": (("point", "axis"), (moment + np.cross(PLACE, support)) @ axes),
        },
        {"posture": ("point", posture), "kind": ("point", kind), "marks": ("point", marks)},
    )


@pytest.fixture(scope="module")
def found(points, tmp_path_factory):
    path = tmp_path_factory.mktemp("tunnel") / "tunnel_mk3.nc"
    write_netcdf(path, points)
    return tunnel_mk3.compute("made", tunnel_mk3.TunnelConfig(tunnel=path)).summary


def test_points_are_averaged_and_doubtful_ones_left_out(points, robot):
    kept = tunnel_mk3.read_points(points, axes_of(robot))
    assert len(kept.posture) == points.sizes["point"] // 2
    assert np.abs(kept.force).max() < 1.0


def test_the_model_that_made_the_points_has_no_error_where_the_robot_is_alone(found):
    assert found["estimated, side wind: points"] == 8
    for group in ("flight postures", "hovering, yaw to 20 deg"):
        for key in ("drag, rms over mean", "lateral force, rms [m2]", "moment, rms [N m at 10 m/s], 97.5 %"):
            measured(key, found[f"estimated, {group}: {key}"], 1e-12)


def test_the_other_sign_of_the_yaw_is_worse(found):
    assert found["yaw opposite to the files': lateral force with the wind, share"] == 1.0
    assert found["yaw the files': mean drag in side wind [m2]"] < 0.0


def test_without_the_points_their_command_is_named(tmp_path):
    config = tunnel_mk3.TunnelConfig(tunnel=tmp_path / "none.nc")
    with pytest.raises(tunnel_mk3.Refused, match="jax-aero data import-tunnel"):
        tunnel_mk3.compute("made", config)
