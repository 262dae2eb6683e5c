"""Joints of a robot by their groups."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jax_aero import rust
from jax_aero.base.terminal import Refused


def joints_of(path: Path, groups: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of the joints in some groups of a robot."""
    robot = rust.Robot(path)
    if unknown := set(groups) - set(robot.joint_groups):
        raise Refused(f"free_groups names `{min(unknown)}`; {robot.name} has {', '.join(robot.joint_groups)}")
    return tuple(robot.joint_names.index(joint) for group in groups for joint in robot.joint_groups[group])
