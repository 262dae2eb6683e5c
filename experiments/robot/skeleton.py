"""Text of a robot's TOML file from a URDF, for the user to check and refine."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments import Refused
from experiments.robot.shapes import Array, Box
from jax_aero.tables import toml_key, toml_value
from jax_aero.urdf import IDENTITY, Joint, Pose, Urdf

AXES = {
    f"{sign}{name}": (-1.0 if sign else 1.0) * row
    for sign in ("", "-")
    for name, row in zip("xyz", np.eye(3), strict=True)
}
"""Directions by name: x, y, z, -x, -y, -z."""

SMALLEST_LINK = 0.1
"""Longest edge below which a link has no aerodynamics [m]."""
PLACEHOLDER = 1e4
"""Effort or velocity from which on it is a placeholder, as exporters write if they know no value."""


@dataclass(frozen=True)
class Thruster:
    """A jet or rotor given on the command line."""

    frame: str
    axis: str
    thrust_max: float
    """Greatest thrust [N]."""
    torque_to_thrust: float = 0.0
    """Moment on the robot about the axis per thrust [m]."""


class Tree:
    """Links and joints of a URDF, in order from the root."""

    def __init__(self, urdf: Urdf) -> None:
        self.links, self.joints = urdf.links, urdf.joints
        carried = {joint.child for joint in self.joints}
        roots = [link for link in self.links if link not in carried]
        if len(roots) != 1:
            raise Refused(f"the URDF has {len(roots)} links that no joint carries; expected one, the base")
        self.base = roots[0]
        if len(carried) < len(self.joints):
            raise Refused("a link of the URDF is the child of more than one joint")

    def child_joints(self, link: str) -> list[Joint]:
        """Return the joints whose parent is this link."""
        return [joint for joint in self.joints if joint.parent == link]

    def chains(self, held: Sequence[str]) -> list[list[Joint]]:
        """Return the moving joints except `held` ones, in tree order, split into chains where the tree branches."""
        chains: list[list[Joint]] = []

        def walk(link: str, chain: list[Joint]) -> None:
            ahead = list(self._next(link, held))
            for joint in ahead:
                follows = chain if len(ahead) == 1 and chain else []
                if not follows:
                    chains.append(follows)
                follows.append(joint)
                walk(joint.child, follows)

        walk(self.base, [])
        return chains

    def _next(self, link: str, held: Sequence[str]) -> Iterator[Joint]:
        for joint in self.child_joints(link):
            if joint.moves and joint.name not in held and not self._follows(joint, held):
                yield joint
            else:
                yield from self._next(joint.child, held)

    def _follows(self, joint: Joint, held: Sequence[str]) -> bool:
        """Return whether a joint mimics one that is held, so that it is held as well; refuse one that would move."""
        leader: Joint | None = joint
        for _ in self.joints:
            if leader is None or not leader.moves or leader.name in held:
                return True
            if leader.mimics is None:
                break
            name = leader.mimics
            leader = next((other for other in self.joints if other.name == name), None)
        if joint.mimics is None:
            return False
        raise Refused(
            f"joint `{joint.name}` is a mimic of `{joint.mimics}`; expected one that moves on its own: "
            f"--hold {joint.name} locks it, --hold {joint.mimics} locks both"
        )

    def rigid_part(self, link: str) -> dict[str, Pose]:
        """Return the links joined rigidly to this one, with their poses in its axes."""
        placed = {link: IDENTITY}
        waiting = [link]
        while waiting:
            here = waiting.pop()
            for joint in self.joints:
                if joint.moves:
                    continue
                if joint.parent == here and joint.child not in placed:
                    placed[joint.child] = placed[here] @ joint.origin
                    waiting.append(joint.child)
                elif joint.child == here and joint.parent not in placed:
                    r = joint.origin.rotation.T
                    placed[joint.parent] = placed[here] @ Pose(r, -r @ joint.origin.position)
                    waiting.append(joint.parent)
        return placed


def nearest_zero(joint: Joint) -> float:
    """Return the position within a joint's limits that is nearest to zero [rad, m]."""
    lower, upper = joint.limits or (0.0, 0.0)
    return min(max(0.0, lower), upper)


def write(
    tree: Tree,
    boxes: dict[str, Box],
    *,
    name: str,
    urdf: Path,
    folder: Path,
    jets: Sequence[Thruster],
    feet: Sequence[str],
    held: Sequence[str],
    forward: str,
) -> str:
    """Return the text of the TOML file in `folder`."""
    for kind, frames in (("jet", [jet.frame for jet in jets]), ("foot", feet)):
        if unknown := [frame for frame in frames if frame not in tree.links]:
            raise Refused(f"{kind} frame `{unknown[0]}` is no link of the URDF; there are {', '.join(tree.links)}")
    if unknown := [joint for joint in held if joint not in [known.name for known in tree.joints]]:
        raise Refused(f"`{unknown[0]}` is no joint of the URDF")
    lines = [
        "# Robot made from its URDF by `jax-aero robot import`. Check what is marked with (?).",
        "# SI units and radians, except keys ending in `_deg`; throttle is in percent.",
        "",
        f"name = {toml_value(name)}",
        f"urdf = {toml_value(os.path.relpath(urdf.resolve(), folder.resolve()))}",
        f"base_link = {toml_value(tree.base)}",
    ]
    if forward != "x":
        lines.append(f"forward_axis = {_row(AXES[forward])}")
    if held:
        places = {joint.name: nearest_zero(joint) for joint in tree.joints if joint.name in held}
        lines.append(f"locked = {toml_value(places)}")
    lines += ["", "# --- joints, in tree order, a group for each chain ---", *_groups(tree.chains(held))]
    links = {link: box for link, box in boxes.items() if box.size.max() >= SMALLEST_LINK}
    lines += ["", "# --- aerodynamic links: cylinders and spheres of the size of the geometry (?) ---"]
    for link, box in links.items():
        lines += _aero_link(link, box)
    lines += [
        "",
        "# Force areas in m2: drag coefficient 0.5 of a sphere, 1.0 across and 0.8 along a cylinder (?).",
    ]
    lines += ["[coefficients.estimated]", *(_areas(link, box) for link, box in links.items())]
    lines += ["", "# --- jets ---", *_jets(jets), "", "# --- feet: extent of the foot's geometry (?) ---"]
    for foot in feet:
        lines += _foot(tree, boxes, foot)
    return "\n".join(lines) + "\n"


def _row(values: Array | Sequence[float]) -> str:
    return "[" + ", ".join(repr(round(float(value), 6) + 0.0) for value in values) + "]"


def _quote_name(name: str, *keys: str) -> list[str]:
    """Return lines that assign a name of the URDF to each of the keys."""
    return [f"{key} = {toml_value(name)}" for key in keys]


def group_name(chain: Sequence[Joint]) -> str:
    """Return a name for a chain, derived from its first joint."""
    return f"{chain[0].name}_chain"


def _groups(chains: Sequence[Sequence[Joint]]) -> list[str]:
    lines = []
    for chain in chains:
        lines += ["", "[[joint_groups]]", f"name = {toml_value(group_name(chain))}", "joints = ["]
        lines += [f"    {{ {', '.join(_joint_entry(joint))} }}," for joint in chain]
        lines += ["]"]
    return lines


def _joint_entry(joint: Joint) -> list[str]:
    entry = [f"name = {toml_value(joint.name)}"]
    if joint.limits is None:
        entry.append("limits = [-1.0, 1.0]" if joint.is_prismatic else "limits_deg = [-180.0, 180.0]")
    if not 0.0 < joint.effort < PLACEHOLDER:
        entry.append("torque_max = 100.0")
    if not 0.0 < joint.velocity < PLACEHOLDER:
        entry.append("velocity_max = 1.0" if joint.is_prismatic else "velocity_max_deg = 180.0")
    return entry


def _cylinder(box: Box) -> tuple[Array, float, float, bool]:
    """Return axis in link axes, diameter [m], length [m], and whether a sphere is a better model."""
    edges = np.sort(box.size)
    if box.is_sphere or edges[2] < 1.2 * edges[0]:
        diameter = float(np.cbrt(np.prod(edges)))
        return np.asarray(box.pose.rotation[:, 2]), diameter, diameter, True
    # The axis is the edge that differs most from the other two: the long one of a limb, the short one of a plate.
    axis = int(np.argmax(box.size)) if edges[2] / edges[1] >= edges[1] / edges[0] else int(np.argmin(box.size))
    across = np.delete(box.size, axis)
    return np.asarray(box.pose.rotation[:, axis]), float(np.sqrt(np.prod(across))), float(box.size[axis]), False


def _aero_link(link: str, box: Box) -> list[str]:
    axis, diameter, length, is_sphere = _cylinder(box)
    lines = ["", "[[aero_links]]", *_quote_name(link, "name", "frame", "family")]
    exact = "[" + ", ".join(repr(float(value) + 0.0) for value in axis) + "]"
    lines += [f"axis = {exact}", f"centre = {_row(box.pose.position)}"]
    lines += [f"diameter = {diameter:.4g}", f"length = {length:.4g}"]
    return [*lines, "is_sphere = true"] if is_sphere else lines


def _areas(link: str, box: Box) -> str:
    _, diameter, length, is_sphere = _cylinder(box)
    disc = 0.25 * np.pi * diameter**2
    if is_sphere:
        return f"{toml_key(link)} = {{ cda = [{0.5 * disc:.4g}, 0.0, 0.0, 0.0, 0.0], cna = 0.0 }}"
    side = diameter * length
    cda = f"[{0.8 * disc:.4g}, 0.0, {side - 0.8 * disc:.4g}, 0.0, 0.0]"
    return f"{toml_key(link)} = {{ cda = {cda}, cna = {side / 3.0:.4g} }}"


def _jets(jets: Sequence[Thruster]) -> list[str]:
    lines = []
    for jet in jets:
        lines += ["", "[[jets]]", *_quote_name(jet.frame, "name", "frame"), f"axis = {_row(AXES[jet.axis])}"]
        if jet.torque_to_thrust != 0.0:
            lines.append(f"torque_to_thrust = {jet.torque_to_thrust!r}")
        lines += [f"thrust_max = {jet.thrust_max!r}", f"engine = {_engine(jet.thrust_max)}"]
    for greatest in sorted({jet.thrust_max for jet in jets}):
        lines += ["", "# Linear, critically damped at 3 rad/s, full thrust at full throttle (?)."]
        lines += [f"[engines.{_engine(greatest)}]"]
        values = {"k_t": -9.0, "k_d": -6.0, "b_u": 0.09 * greatest, "throttle_min": 0.0, "throttle_max": 100.0}
        keys = ("k_t", "k_tt", "k_d", "k_dd", "k_td", "b_u", "b_t", "b_d", "b_uu", "c", "throttle_min", "throttle_max")
        lines += [f"{key} = {values.get(key, 0.0)!r}" for key in keys]
    return lines


def _engine(thrust_max: float) -> str:
    """Return the name of the engine for a greatest thrust [N], as a TOML string."""
    return f'"linear_{thrust_max!r}"'


def _foot(tree: Tree, boxes: dict[str, Box], frame: str) -> list[str]:
    """Return a rectangle around the corners of the foot's boxes within 5 cm above the lowest, in axes of the frame."""
    part = tree.rigid_part(frame)
    corners = [boxes[link].corners @ pose.rotation.T + pose.position for link, pose in part.items() if link in boxes]
    if not corners:
        raise Refused(f"foot `{frame}`: no link that is fixed to it has geometry")
    points = np.concatenate(corners)
    low_points = points[points[:, 2] <= points[:, 2].min() + 0.05]
    (x_min, y_min), (x_max, y_max) = low_points[:, :2].min(axis=0), low_points[:, :2].max(axis=0)
    vertices = [[x_min, y_max, 0.0], [x_max, y_max, 0.0], [x_max, y_min, 0.0], [x_min, y_min, 0.0]]
    rows = ", ".join(_row(vertex) for vertex in vertices)
    return ["", "[[feet]]", *_quote_name(frame, "name", "frame"), f"vertices = [{rows}]"]
