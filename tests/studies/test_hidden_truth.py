"""Robots whose truth is hidden: how they are drawn, what is true of them, and what is counted."""

from collections import Counter

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.studies.hidden_truth import draw, study
from jax_aero import rust
from jax_aero.aero import NoAero
from jax_aero.base.places import CONFIGS
from jax_aero.body.robot import load_robot
from jax_aero.identify import motion
from jax_aero.identify.prior import numbers_of, prior_of


def test_winds_missions_and_robots_outside_are_balanced():
    cases = Counter(draw.case_of(number) for number in range(72))
    assert {case[:2] for case in cases} == {(wind, mission) for wind in draw.WINDS for mission in draw.MISSIONS}
    assert {count for case, count in cases.items() if case.is_outside} == {2}
    assert {count for case, count in cases.items() if not case.is_outside} == {6}


def test_a_robot_outside_differs_link_by_link(tmp_path):
    source = CONFIGS / "robot" / "ironcub_mk1.toml"
    before = load_robot(source)
    after = load_robot(draw.write_outside(source, tmp_path, np.random.default_rng(1)))
    chest = before.body_names.index(draw.LOAD_LINK)
    ratio = after.masses / before.masses
    assert ratio[chest] - 1.0 == pytest.approx(draw.LOAD / before.masses[chest], abs=1.1 * draw.LINK_MASS)
    others = np.delete(np.arange(len(ratio)), chest)
    assert 0.0 < np.abs(ratio[others] - 1.0).min() < np.abs(ratio[others] - 1.0).max() <= draw.LINK_MASS
    assert 0.0 < np.abs(after.coms - before.coms)[others].max() <= draw.LINK_CENTRE
    assert rust.Robot(tmp_path / "outside.toml").mass == pytest.approx(np.sum(after.masses))


@pytest.mark.usefixtures("x64")
def test_truth_of_the_whole_robot_is_what_its_numbers_say():
    """Whatever bodies have of their own, mass, centre and inertia are those that the numbers were given."""
    robot = load_robot(CONFIGS / "robot" / "ironcub_mk1.toml")
    posture = 0.2 * np.ones(robot.n_joints)
    size = sum(np.size(part) for part in prior_of(robot, draw.WIDTHS))
    numbers = numbers_of(robot, np.zeros(size))._replace(
        mass=np.array(0.04), com=np.array([0.01, 0.0, -0.02]), inertia=np.array(0.15),
        bodies=0.03 * np.random.default_rng(2).normal(size=(len(robot.masses), 10)),
    )  # fmt: skip
    actual = motion.robot_with(motion.Model(robot, NoAero(), jnp.asarray(posture)), numbers)
    for found, given in zip(study.whole(robot, actual, posture), numbers[:3], strict=True):
        np.testing.assert_allclose(found, given, rtol=1e-9, atol=1e-12)


def test_only_what_is_found_is_counted():
    counted = np.array([[True, False], [True, True]])
    assert study.bootstrapped(counted, counted)[1] == 1.0
    low, high = study.bootstrapped(np.ones((50, 20), dtype=bool), np.arange(1000).reshape(50, 20) % 10 > 0)
    assert low < 0.9 + 1e-9
    assert high > 0.9 - 1e-9
    robots = np.repeat([[True], [False]], 10, axis=1)  # all of one robot, none of another
    assert study.bootstrapped(np.ones_like(robots), robots) == (0.0, 1.0)
