"""Distances of segments, and of the jets' axes from the body in the paper's posture."""

import tomllib

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jax_aero.base import places
from jax_aero.symbolic import load_robot
from jax_aero.symbolic.clearance import pairs, segment_distance
from jax_aero.symbolic.kinematics import Kinematics


@pytest.fixture(scope="module")
def distance():
    points = [ca.SX.sym(name, 3) for name in ("a", "u", "b", "v")]
    value = segment_distance((points[0], points[1]), (points[2], points[3]))
    return ca.Function("distance", points, [value])


def brute_force(a, u, b, v):
    """The nearest of many points of one segment to the other segment, which is known in closed form."""
    t = np.linspace(0.0, 1.0, 2001)[:, None]
    points = a + t * u
    length = max(float(v @ v), 1e-300)
    s = np.clip((points - b) @ v / length, 0.0, 1.0)[:, None]
    return float(np.linalg.norm(points - b - s * v, axis=1).min())


vectors = st.lists(st.floats(-1.0, 1.0, width=16), min_size=3, max_size=3).map(np.array)


@settings(deadline=None, max_examples=300)
@given(a=vectors, u=vectors, b=vectors, v=vectors)
def test_the_distance_of_two_segments(distance, a, u, b, v):
    np.testing.assert_allclose(float(distance(a, u, b, v)), brute_force(a, u, b, v), atol=2e-3)


@pytest.mark.close_to_tolerance("the distance is smoothed by 1e-6 m")
@pytest.mark.parametrize(
    ("a", "u", "b", "v", "expected"),
    [
        ([0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], 1.0),  # parallel
        ([0, 0, 0], [1, 0, 0], [3, 0, 0], [1, 0, 0], 2.0),  # on one line
        ([0, 0, 0], [1, 0, 0], [0.5, -1, 0], [0, 2, 0], 0.0),  # crossing
        ([0, 0, 0], [0, 0, 0], [0, 3, 4], [0, 0, 0], 5.0),  # two points
    ],
)
def test_special_segments(distance, a, u, b, v, expected, measured):
    measured("distance", abs(float(distance(a, u, b, v)) - expected), 2e-6)


@pytest.mark.close_to_tolerance("the expected figure is typed to the digits that the tolerance allows")
def test_the_paper_chose_its_posture_to_keep_jets_from_the_body(measured):
    robot = load_robot(places.ROBOT)
    tree = Kinematics(robot)
    found = pairs(tree, 1.5)
    assert len(found) == 4 * (13 - 1 + 2)
    (distances,) = tree.evaluate_at_base(ca.vertcat(*(pair.distance for pair in found)))
    at = ca.Function("at", [tree.base_position, tree.base_rotation, tree.joint_position], [distances])
    table = tomllib.loads(places.find("simulator", "flight").read_text())
    values = at(np.zeros(3), np.eye(3), table["initial"]["joint_position"]).full()[:, 0]
    nearest = found[int(values.argmin())]
    measured("clearance", abs(values.min() - 0.0352), 2e-4)
    assert (nearest.jet.startswith("chest"), nearest.link) == (True, "root_link")
    # The exhaust of a turbine leaves downwards: every jet passes its own leg at a distance, none points at the head.
    assert values[[pair.link == "head" for pair in found]].min() > 0.25


def test_a_sole_is_the_capsule_along_its_rectangle(measured):
    """Standing in another place and turned, beside the distance from a cloud of points along its spine."""
    robot = load_robot(places.ROBOT)
    tree = Kinematics(robot)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    place = (np.array([1.0, 2.0, 3.0]), turn, np.linspace(-0.3, 0.3, robot.n_joints))
    found = [pair for pair in pairs(tree, 1.5) if pair.link in robot.soles]
    assert len(found) == 4 * 2
    for pair in found:
        jet = next(jet for jet in robot.jets if jet.name == pair.jet)
        carrier, sole = tree.bodies[jet.body], tree.poses[pair.link]
        corners = robot.soles[pair.link]
        low, high = corners.min(axis=0), corners.max(axis=0)
        along, across = np.argsort(high - low)[[-1, -2]]
        ends = [0.5 * (low + high) for _ in range(2)]
        ends[0][along], ends[1][along] = low[along], high[along]
        wanted = ca.vertcat(
            pair.distance, carrier.point(jet.position), -1.5 * carrier.direction(jet.axis), *map(sole.point, ends)
        )
        (here,) = tree.evaluate_at_base(wanted)
        at = ca.Function("at", [tree.base_position, tree.base_rotation, tree.joint_position], [here])
        distance, *points = np.split(at(*place).full()[:, 0], [1, 4, 7, 10])
        expected = brute_force(points[0], points[1], points[2], points[3] - points[2])
        expected -= 0.5 * (high - low)[across]
        # The cloud is 1 mm apart: second order in it at a distance of decimetres; the distance is smoothed by 1e-6 m.
        measured(f"{pair.jet} to {pair.link}", abs(distance[0] - expected), 5e-6)
