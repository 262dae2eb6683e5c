"""The mirror image of a robot: names of the opposite side, and signs of angles."""

from __future__ import annotations

from collections.abc import Sequence

ODD_JOINTS = ("torso_roll", "torso_yaw")
"""Joints whose angle changes sign in the mirror image; the angles of the limbs are exchanged between sides."""


def mirror_name(name: str) -> str:
    """Return the name of the joint or link on the opposite side: left and right swapped between underscores.

    >>> mirror_name("chest_l_jet_turbine"), mirror_name("right_knee"), mirror_name("head")
    ('chest_r_jet_turbine', 'left_knee', 'head')
    """
    opposite = {"l": "r", "r": "l", "left": "right", "right": "left"}
    return "_".join(opposite.get(part, part) for part in name.split("_"))


def opposite_indices(names: Sequence[str]) -> list[int]:
    """Return for every joint or link the index of the one on the opposite side.

    Raises
    ------
    ValueError
        If a name has none opposite to it.
    """
    opposite = []
    for name in names:
        twin = mirror_name(name)
        if twin not in names:
            raise ValueError(f"`{name}` has no `{twin}` opposite to it")
        opposite.append(list(names).index(twin))
    return opposite
