"""Total force and moment in the loss: the map from outputs, its weights, and the errors that a run reports."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.aero.dataset import JOINTS
from jax_aero.aero.network import init_network, raw_output
from jax_aero.aero.posture import link_arms, link_frames, total_wrench
from jax_aero.base.places import ROBOT
from jax_aero.body.robot import load_robot
from jax_aero.train import Settings, fit, samples_of, total_error, totals_of
from jax_aero.train.samples import make_samples
from tests.measurements import measured
from tests.units.test_import_cfd import read, table


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROBOT)


def test_a_moment_is_that_of_forces_at_the_links_centres_about_the_centre_of_mass(robot):
    rng = np.random.default_rng(1)
    joints, areas = rng.uniform(-20.0, 20.0, (2, len(JOINTS))), rng.normal(size=(2, 13, 3))
    found, frames, links = total_wrench(robot, joints, areas), link_frames(robot, joints), robot.aero_links
    for row in range(2):
        moment = np.zeros(3)
        for link in range(13):
            centre = frames.positions[row, link] + frames.rotations[row, link] @ np.asarray(links.centres[link])
            moment += np.cross(centre - frames.com[row], areas[row, link])
        np.testing.assert_allclose(found.moment_volume[row], moment, atol=1e-14)
        np.testing.assert_allclose(found.force_area[row], areas[row].sum(0), atol=1e-14)
    np.testing.assert_allclose(link_arms(robot, joints[:1])[0], link_arms(robot, joints)[0], atol=0)


@pytest.mark.parametrize(("frame", "layout"), [("link", "link"), ("base", "component"), ("wind", "component")])
def test_totals_are_those_of_the_outputs_whatever_their_frame(robot, frame, layout):
    data = read(table())
    network = init_network(jax.random.key(1), robot, hidden=(4,), frame=frame, layout=layout)
    samples = make_samples(network, robot, data.joint_position_deg, data.wind_b, data.force_area_b)
    totals = totals_of(network, robot, data.joint_position_deg, data.wind_b)
    wrench = total_wrench(robot, data.joint_position_deg, data.force_area_b)
    found = np.einsum("nij,nj->ni", totals.astype(float), samples.y.astype(float))
    off = np.abs(found - np.concatenate([wrench.force_area, wrench.moment_volume], axis=1)).max()
    measured("totals of the outputs", off, 1e-7, because="39 products in single precision, areas of 0.01 m2")


def test_the_loss_weighs_force_and_moment_apart():
    output, y = jnp.ones((2, 1, 39)), jnp.zeros((1, 39))
    totals = np.zeros((1, 6, 39))
    totals[0, 0, :2], totals[0, 4, 5] = 1.0, 3.0
    weights = jnp.array([10.0] * 3 + [100.0] * 3)
    assert float(total_error(output, y, jnp.asarray(totals), weights)) == pytest.approx(10.0 * 4.0 + 100.0 * 9.0)


def test_a_loss_of_totals_alone_is_what_training_lowers(robot):
    data = read(table())
    network = init_network(jax.random.key(2), robot, hidden=(8,), start="unit")
    samples = samples_of(network, robot, data, with_totals=True)
    weighed = Settings(epochs=40, learning_rate=1e-2, total_force=10.0, total_moment=100.0)

    def errors(settings):
        trained = fit(network, samples, None, settings, 1).network
        output = np.asarray(jax.vmap(functools.partial(raw_output, trained))(samples.x))
        off = np.einsum("nij,nj->ni", samples.totals, output - samples.y)
        return np.mean(off[:, 3:] ** 2)

    assert errors(weighed) < errors(Settings(epochs=40, learning_rate=1e-2))
    with pytest.raises(ValueError, match="expected samples with totals"):
        fit(network, samples._replace(totals=None), None, weighed, 1)
