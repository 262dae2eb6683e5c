"""Text of a robot's TOML file from a URDF, for the user to check and refine."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero.base.places import did_you_mean
from jax_aero.base.plain_values import toml_key, toml_value
from jax_aero.base.terminal import Refused
from jax_aero.body.urdf import IDENTITY, Joint, Pose, Urdf
from jax_aero.robot.shapes import Array, Box

AXES = {
    f"{sign}{name}": (-1.0 if sign else 1.0) * row
    for sign in ("", "-")
    for name, row in zip("xyz", np.eye(3), strict=True)
}
"""Directions by name: x, y, z, -x, -y, -z."""

SMALLEST_LINK = 0.1
"""Longest edge below which a link has no aerodynamics [m]."""
PLACEHOLDER = 1e4
"""Effort or velocity from which on it is a placeholder, as exporters write for an unknown value."""

ALONG = 0.99
"""Cosine of the angle between two axes from which they are the same."""


@dataclass(frozen=True)
class Thruster:
    """A jet or rotor given on the command line."""

    frame: str
    axis: str
    thrust_max: float
    """Greatest thrust [N]."""
    torque_to_thrust: float = 0.0
    """Moment on the robot about the axis per thrust [m]."""


def _quoted(kind: str, names: Sequence[str]) -> str:
    """Return names with their kind."""
    return f"{kind}{'' if len(names) == 1 else 's'} {', '.join(f'`{name}`' for name in names)}"


class Tree:
    """Links and joints of a URDF, in order from the root."""

    def __init__(self, urdf: Urdf) -> None:
        self.links, self.joints, self.inertials = urdf.links, urdf.joints, urdf.inertials
        carried = {joint.child for joint in self.joints}
        roots = [link for link in self.links if link not in carried]
        if len(roots) != 1:
            raise Refused(f"the URDF has {len(roots)} links that no joint carries; expected one, the base")
        self.base = roots[0]
        if len(carried) < len(self.joints):
            raise Refused("a link of the URDF is the child of more than one joint")

    def check_frames(self, jets: Sequence[str], feet: Sequence[str], held: Sequence[str]) -> None:
        """Refuse options that name no link or joint of the URDF."""
        joints = [joint.name for joint in self.joints]
        refused = []
        for option, names, known in (("jet", jets, self.links), ("foot", feet, self.links), ("hold", held, joints)):
            kind = "joint" if option == "hold" else "link"
            unknown = [
                f"`{name}` is no {kind} of the URDF{did_you_mean(name, known)}" for name in names if name not in known
            ]
            refused += [f"--{option}: {', '.join(unknown)}"] if unknown else []
        if refused:
            raise Refused("; ".join(refused))

    def child_joints(self, link: str) -> list[Joint]:
        """Return the joints whose parent is this link."""
        return [joint for joint in self.joints if joint.parent == link]

    def chains(self, held: Sequence[str]) -> list[list[Joint]]:
        """Return the moving joints except `held` ones, in tree order, split into chains where the tree branches."""
        chains: list[list[Joint]] = []
        waiting: list[tuple[Joint, list[Joint]]] = [(joint, []) for joint in reversed(self._next(self.base, held))]
        while waiting:
            joint, chain = waiting.pop()
            if not chain:
                chains.append(chain)
            chain.append(joint)
            ahead = self._next(joint.child, held)
            waiting += [(other, chain if len(ahead) == 1 else []) for other in reversed(ahead)]
        return chains

    def moving(self, held: Sequence[str]) -> list[Joint]:
        """Return the joints of the chains."""
        return [joint for chain in self.chains(held) for joint in chain]

    def _next(self, link: str, held: Sequence[str]) -> list[Joint]:
        """Return the moving joints that no other one separates from a link, in tree order."""
        joints, waiting = [], self.child_joints(link)[::-1]
        while waiting:
            joint = waiting.pop()
            if joint.moves and joint.name not in held and not self._follows(joint, held):
                joints.append(joint)
            else:
                waiting += self.child_joints(joint.child)[::-1]
        return joints

    def with_mimics(self, held: Sequence[str], *, hold_mimics: bool) -> list[str]:
        """Return the held joints and, with `hold_mimics`, those that mimic one that moves, which are refused else."""
        mimics = [joint for joint in self.joints if joint.moves and joint.mimics is not None]
        mimics = [joint for joint in mimics if joint.name not in held and not self._follows(joint, held)]
        if not mimics or hold_mimics:
            return [*held, *(joint.name for joint in mimics)]
        ways = " ".join(f"--hold {joint.name}" for joint in mimics)
        leaders = {joint.mimics: [other.name for other in mimics if other.mimics == joint.mimics] for joint in mimics}
        named = [
            f"{_quoted('joint', names)} {'is a mimic' if len(names) == 1 else 'are mimics'} of `{leader}`"
            for leader, names in leaders.items()
        ]
        expected = f"joints that move on their own: --hold-mimics locks all of these, as does {ways}"
        both = " ".join(f"--hold {leader}" for leader in leaders)
        raise Refused(f"{', '.join(named)}; expected {expected}; {both} locks what is mimicked too")

    def _follows(self, joint: Joint, held: Sequence[str]) -> bool:
        """Return whether a joint mimics one that is held, so that it is held as well."""
        leader: Joint | None = joint
        for _ in self.joints:
            if leader is None or not leader.moves or leader.name in held:
                return True
            if leader.mimics is None:
                break
            name = leader.mimics
            leader = next((other for other in self.joints if other.name == name), None)
        return False

    def spinning(self, jets: Sequence[Thruster], held: Sequence[str]) -> list[str]:
        """Return a warning of joints without limits that turn jets about their own axes, as rotors spin."""
        names = []
        for joint in self.moving(held):
            if joint.axis is None or joint.limits is not None or joint.is_prismatic:
                continue
            part = self.rigid_part(joint.child)
            axes = [part[jet.frame].rotation @ AXES[jet.axis] for jet in jets if jet.frame in part]
            if any(abs(joint.axis @ axis) > ALONG for axis in axes):
                names.append(joint.name)
        if not names:
            return []
        turn = "turns a jet about its axis" if len(names) == 1 else "turn jets about their axes"
        ways = " ".join(f"--hold {name}" for name in names)
        what = f"{_quoted('joint', names)} {turn} without limits, as rotors spin"
        return [f"{what}: expected {ways}; a rotor's moment is the last part of --jet"]

    def rigid(self, link: str, moving: Collection[str]) -> list[str]:
        """Return a link and those below it that no moving joint separates from it."""
        links = [link]
        for here in links:
            links += [joint.child for joint in self.child_joints(here) if joint.name not in moving]
        return links

    def points(self, boxes: Mapping[str, Box]) -> dict[str, Array]:
        """Return the origin of every link and the corners of its box (k, 3) in base axes, in the posture zero [m]."""
        placed, by_link = [(self.base, IDENTITY)], {}
        for link, pose in placed:
            corners = boxes[link].corners if link in boxes else np.zeros((0, 3))
            by_link[link] = np.vstack([np.zeros(3), corners]) @ pose.rotation.T + pose.position
            placed += [(joint.child, pose @ joint.origin) for joint in self.child_joints(link)]
        return by_link

    def lowest(self, boxes: Mapping[str, Box]) -> float:
        """Return the height of the lowest of the `points` above the base [m]."""
        return min(float(points[:, 2].min()) for points in self.points(boxes).values())

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
    if small := [link for link in boxes if link not in links]:
        lines.append(f"# None of {', '.join(map(toml_value, small))}, smaller than {SMALLEST_LINK} m.")
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


def _groups(chains: Sequence[Sequence[Joint]]) -> list[str]:
    lines = []
    for chain in chains:
        lines += ["", "[[joint_groups]]", f"name = {toml_value(chain[0].name + '_chain')}", "joints = ["]
        lines += [_joint_entry(joint) for joint in chain]
        lines += ["]"]
    return lines


def _joint_entry(joint: Joint) -> str:
    entries = {"name": joint.name, **(guessed := guesses(joint))}
    line = f"    {{ {', '.join(f'{key} = {toml_value(value)}' for key, value in entries.items())} }},"
    return f"{line}  # (?)" if guessed else line


def guesses(joint: Joint) -> dict[str, Any]:
    """Return values of what the URDF does not say of a joint, by key of the TOML file. Negative ones are refused."""
    unit, half, fast = ("", 1.0, 1.0) if joint.is_prismatic else ("_deg", 180.0, 180.0)
    guess: dict[str, Any] = {}
    if joint.limits is None:
        guess[f"limits{unit}"] = [-half, half]
    if joint.effort == 0.0 or joint.effort >= PLACEHOLDER:
        guess["torque_max"] = 100.0
    if joint.velocity == 0.0 or joint.velocity >= PLACEHOLDER:
        guess[f"velocity_max{unit}"] = fast
    return guess


def guessed(joints: Sequence[Joint]) -> list[str]:
    """Return a warning for each key that some joints have a guess of."""
    alike: dict[tuple[str, str], list[str]] = {}
    for joint in joints:
        for key, value in guesses(joint).items():
            alike.setdefault((key, toml_value(value)), []).append(f"`{joint.name}`")
    return [
        f"{key} = {value} of joint {', '.join(names)} is a guess, marked (?): the URDF says nothing usable"
        for (key, value), names in alike.items()
    ]


def shown_limits(joint: Joint) -> tuple[float, float, str]:
    """Return the range of a joint's positions in degrees or metres, with the unit."""
    unit = "m" if joint.is_prismatic else "deg"
    if joint.limits is None:
        lower, upper = guesses(joint)["limits" if joint.is_prismatic else "limits_deg"]
        return lower, upper, unit
    lower, upper = joint.limits if joint.is_prismatic else np.degrees(joint.limits).tolist()
    return lower, upper, unit


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
