"""Distances of exhausts and links from each other, with exhausts as segments and links as capsules."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from jax_aero.symbolic.kinematics import Kinematics
from jax_aero.symbolic.robot import AeroLink, Jet
from jax_aero.symbolic.spatial import SX

TINY = 1e-12
"""Keeps quotients finite if a segment is a point or two segments are parallel [m², m⁴]."""


class Capsule(NamedTuple):
    """All points within a radius [m] of a segment."""

    start: SX
    """Start of the segment [m, inertial axes]."""
    way: SX
    """From its start to its end [m]."""
    radius: float
    """[m]; zero for an exhaust."""

    def distance(self, other: Capsule) -> SX:
        """Return the distance between the surfaces [m]; negative if one capsule enters the other."""
        return segment_distance((self.start, self.way), (other.start, other.way)) - self.radius - other.radius


class Pair(NamedTuple):
    """An exhaust and a link that must keep clear of each other."""

    jet: str
    link: str
    distance: SX
    """Distance from the axis of the jet to the surface of the link [m]; negative if the axis enters the link."""


def exhaust(tree: Kinematics, jet: Jet, length: float) -> Capsule:
    """Return the segment of `length` [m] from the nozzle opposite to the thrust."""
    pose = tree.bodies[jet.body]
    return Capsule(pose.point(jet.position), -length * pose.direction(jet.axis), 0.0)


def around(tree: Kinematics, link: AeroLink) -> Capsule:
    """Return the capsule around the cylinder (centre, axis, length, diameter) of a link."""
    half = 0.0 if link.is_sphere else 0.5 * link.length
    pose = tree.bodies[link.body]
    return Capsule(
        pose.point(link.centre - half * link.axis), pose.direction(2 * half * link.axis), 0.5 * link.diameter
    )


def under(tree: Kinematics, sole: str) -> Capsule:
    """Return the capsule along the rectangle of a sole, as wide as the rectangle."""
    corners = tree.robot.soles[sole]
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    long = np.eye(3)[int(np.argmax(reach))] * reach
    pose = tree.poses[sole]
    return Capsule(pose.point(middle - long), pose.direction(2 * long), float(np.sort(reach)[1]))


def pairs(tree: Kinematics, plume_length: float) -> list[Pair]:
    """Return all pairs of a jet's exhaust with an aerodynamic link other than its own turbine, or with a sole."""
    robot = tree.robot
    soles = {sole: under(tree, sole) for sole in robot.soles}
    every = []
    for jet in robot.jets:
        plume = exhaust(tree, jet, plume_length)
        links = {link.name: around(tree, link) for link in robot.aero_links if link.frame != jet.frame}
        every += [Pair(jet.name, name, plume.distance(capsule)) for name, capsule in (links | soles).items()]
    return every


def kept_apart(tree: Kinematics, clearance: Mapping[str, Any]) -> SX:
    """Return the distances [m] of `mpc.clearance`, of exhausts and links from links and soles."""
    capsules = {link.name: around(tree, link) for link in tree.robot.aero_links}
    capsules |= {sole: under(tree, sole) for sole in tree.robot.soles}
    first = [exhaust(tree, jet, clearance["exhaust"]) for jet in tree.robot.jets]
    first += [capsules[name] for name in clearance["links"]]
    return ca.vertcat(*(one.distance(capsules[name]) for one in first for name in clearance["apart_from"]))


def segment_distance(first: tuple[SX, SX], second: tuple[SX, SX]) -> SX:
    """Return the distance of two segments [m], each given by its start and the vector to its end [m].

    Computes the nearest points of two lines with parameters clamped in turn, as in Ericson, Real-Time Collision
    Detection (2005), section 5.1.9. The gradient is correct wherever the nearest points are unique.
    """
    (start_1, d_1), (start_2, d_2) = first, second
    between = start_1 - start_2
    a, b, e = ca.dot(d_1, d_1) + TINY, ca.dot(d_1, d_2), ca.dot(d_2, d_2) + TINY
    c, f = ca.dot(d_1, between), ca.dot(d_2, between)
    s = _clamp((b * f - c * e) / (a * e - b * b + TINY))
    t = _clamp((b * s + f) / e)
    s = _clamp((b * t - c) / a)
    gap = between + s * d_1 - t * d_2
    return ca.sqrt(ca.dot(gap, gap) + TINY)


def _clamp(x: SX) -> SX:
    return ca.fmin(ca.fmax(x, 0), 1)
