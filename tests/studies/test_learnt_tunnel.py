"""The study of what postures in the wind tunnel teach: its points, its orders, and that it learns."""

import numpy as np
import pytest
import xarray as xr

from experiments.studies.learnt_tunnel import study
from jax_aero import rust
from jax_aero.aero.dataset import wind_direction
from jax_aero.aero.network_card import load_network
from jax_aero.aero.posture import total_wrench
from jax_aero.base import places
from jax_aero.body.robot import load_robot
from jax_aero.cfd.models import AERO, evaluate_areas
from jax_aero.data.ironcub import JOINTS, joint_position
from jax_aero.train import from_flights


@pytest.fixture(scope="module")
def robot():
    return load_robot(places.ROBOT)


@pytest.fixture(scope="module")
def data(robot):
    """Return what the balance would have measured of the shipped network, by the way of other studies."""
    rng = np.random.default_rng(4)
    count = 12
    joints = np.repeat(rng.uniform(-15.0, 15.0, (3, len(JOINTS))), 4, axis=0)
    pitch, yaw = rng.uniform(30.0, 90.0, count), rng.uniform(-20.0, 20.0, count)
    areas = evaluate_areas(robot, rust.load_aero(AERO / "network.toml"), joints, 17.0 * wind_direction(pitch, yaw))
    force, moment = total_wrench(robot, joint_position(robot, joints), areas)
    return xr.Dataset(
        {
            "pitch": ("point", pitch),
            "yaw": ("point", yaw),
            "joint_position": (("point", "joint"), joints),
            "force_area": (("point", "axis"), force),
            "moment_com": (("point", "axis"), moment),
        }
    )


def test_a_measurement_of_a_network_is_what_that_network_says(robot, data):
    """Signs, axes and units of wind, force and moment."""
    points = study.points_of(data, robot)
    force, moment = study.errors(load_network(study.CFD, robot), points, robot)
    size = np.sqrt((points.wrench[:, :3] ** 2).sum(1).mean()), np.sqrt((points.wrench[:, 3:] ** 2).sum(1).mean())
    assert force < 1e-5 * size[0]  # single precision
    assert moment < 1e-4 * size[1]
    assert size[0] == pytest.approx(61.25 * np.sqrt((data["force_area"].values ** 2).sum(1).mean()))


def test_whole_postures_judge_that_nothing_learns_from():
    names = ["a", "b", "b", "c", "d", "e"]
    first, last = study.split(names, 2, np.random.default_rng(0))
    assert len(first) == 2
    assert set(first) | last == set(names)
    assert not set(first) & last


def test_points_teach_the_force_that_they_have(robot, data):
    points = study.points_of(data, robot)
    settings, _ = from_flights.read_settings(study.SETTINGS, {})
    network, fitted = study.learn(study.Tunnel(steps=150), settings, points, robot, 0)
    size = float(np.sqrt((points.wrench[:, :3] ** 2).sum(1).mean()))
    assert study.errors(network, points, robot)[0] < 0.5 * size
    assert study.errors(fitted, points, robot)[0] < 0.2 * size
    assert study.take(points, np.array([3, 5])).wrench.tolist() == points.wrench[[3, 5]].tolist()
