"""Masses that a robot cannot have: none where links move, or an inertia that their geometry does not allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jax_aero.base.terminal import Refused
from jax_aero.body.urdf import Joint
from jax_aero.robot.shapes import Box
from jax_aero.robot.skeleton import Tree

GREATEST = 2.0
"""Greatest radius of gyration, and distance of the centre of mass from the middle of the geometry, relative to half the
geometry's diagonal; of masses within the geometry neither exceeds 1."""


LEAST, LEAST_OF_ALL = 0.01, 1e-5
"""Least radius of gyration, relative to half the geometry's diagonal, or for a link without geometry to the robot's."""


def require(tree: Tree, moving: Sequence[Joint]) -> list[str]:
    """Refuse a base, or a joint that moves, without mass behind it, with the option that helps.

    Return a note of every link without mass between two joints, which moves with what hangs from it.
    """
    names = {joint.name for joint in moving}

    def has_mass(link: str) -> bool:
        return any(tree.inertials[part].mass != 0.0 for part in tree.rigid(link, names) if part in tree.inertials)

    notes, idle = [], []
    for joint in moving:
        if has_mass(joint.child):
            continue
        behind = [other for other in moving if other.parent in tree.rigid(joint.child, names)]
        if any(has_mass(other.child) for other in behind):
            notes.append(f"link `{joint.child}` has no mass: it moves with what joint `{behind[0].name}` carries")
        else:
            idle.append(joint)
    if idle:
        moved = ", ".join(f"link `{joint.child}` has no mass, but joint `{joint.name}` moves it" for joint in idle)
        held = " ".join(f"--hold {joint.name}" for joint in idle)
        raise Refused(f"{moved}; expected an <inertial>, or that the joint is held: {held}")
    if not has_mass(tree.base):
        base = tree.rigid(tree.base, names)
        ways = [f"--hold {joint.name}" for joint in moving if joint.parent in base]
        way = f", or a held joint that adds one: {' or '.join(ways)}" if ways else ""
        raise Refused(f"the base, link `{tree.base}`, has no mass; expected an <inertial>{way}")
    return notes


def doubts(tree: Tree, boxes: Mapping[str, Box]) -> list[str]:
    """Return warnings of masses that cannot be within the geometry of their link, or of the robot if it has none."""
    whole = np.concatenate(list(tree.points(boxes).values()))
    size = float(np.linalg.norm(np.ptp(whole, axis=0)))
    warnings = []
    for link, (mass, com, inertia) in tree.inertials.items():
        box = boxes.get(link)
        middle, reach = (box.pose.position, 0.5 * float(np.linalg.norm(box.size))) if box else (np.zeros(3), size)
        if mass <= 0.0 or reach == 0.0:
            continue
        greatest, least = float(np.linalg.eigvalsh(inertia)[-1]), reach * (LEAST if box else LEAST_OF_ALL)
        radius, away = float(np.sqrt(max(greatest, 0.0) / mass)), float(np.linalg.norm(com - middle))
        place = "the middle of its geometry" if box else "its origin"
        extent = f"{'its geometry' if box else 'the robot'} reaches {reach:.2g} m"
        if not least < radius <= GREATEST * reach:
            of = f"radius of gyration of link `{link}` is {radius:.3g} m ({greatest:.3g} kg m2, {mass:.3g} kg)"
            warnings.append(f"{of}, but {extent}; expected an inertia in kg m2")
        if away > GREATEST * reach:
            of = f"centre of mass of link `{link}` is {away:.3g} m from {place}"
            warnings.append(f"{of}, but {extent}; expected metres")
    return warnings
