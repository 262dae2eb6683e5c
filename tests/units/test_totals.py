"""Total force and moment of the force areas of the links."""

import numpy as np

from jax_aero.aero.posture import link_arms, link_frames, total_wrench
from jax_aero.base.places import ROBOT
from jax_aero.body.robot import load_robot


def test_a_moment_is_that_of_forces_at_the_links_centres_about_the_centre_of_mass():
    robot = load_robot(ROBOT)
    rng = np.random.default_rng(1)
    joints, areas = rng.uniform(-0.3, 0.3, (2, robot.n_joints)), rng.normal(size=(2, 13, 3))
    found, frames, links = total_wrench(robot, joints, areas), link_frames(robot, joints), robot.aero_links
    for row in range(2):
        moment = np.zeros(3)
        for link in range(13):
            centre = frames.positions[row, link] + frames.rotations[row, link] @ np.asarray(links.centres[link])
            moment += np.cross(centre - frames.com[row], areas[row, link])
        np.testing.assert_allclose(found.moment_volume[row], moment, atol=1e-14)
        np.testing.assert_allclose(found.force_area[row], areas[row].sum(0), atol=1e-14)
    np.testing.assert_allclose(link_arms(robot, joints[:1])[0], link_arms(robot, joints)[0], atol=0)
