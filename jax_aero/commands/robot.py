"""Import a robot: `jax-aero robot import URDF --jet FRAME[:AXIS]:MAX[:MOMENT] ... [--name NAME] [--out DIR]`.

Writes a description of the robot from the URDF (base, joints in tree order with limits, groups by chain, jets,
aerodynamic links sized by the geometry, feet), checks it, trims the robot in still air, and flies it: a hover of ten
seconds and, with --mission, the paper's flight in 10 m/s of lateral wind. The user can refine all files in DIR:

    robot.toml  controller.toml  NAME_hover.toml  NAME_mission.toml    fly again with `jax-aero fly DIR/NAME_hover.toml`
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.arguments import Parser
from jax_aero.base.files import complete_folder
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.body.urdf import Joint, read_urdf
from jax_aero.results import study
from jax_aero.robot import masses, shapes, skeleton

if TYPE_CHECKING:
    from jax_aero.robot.flight import ImportResult

CONTROLLERS = ("mpc", "observer", "aero_aware")
"""Those of `configs/control` that can be scaled to a robot; the first is the default."""

THRUSTER = "FRAME[:AXIS]:MAX[:MOMENT]"

START_HEIGHT, CLEARANCE = 1.0, 0.1
"""Height of the base at the start, and least height of what is lowest in the posture zero [m]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status: 1 if the robot has no trim or does not complete a flight."""
    given = _parser().parse_args(arguments)

    def work() -> int:
        jets, posed = [jet.frame for jet in given.jets], [joint for joint, _ in given.posture_deg]
        for option, names in (("jet", jets), ("foot", given.feet), ("posture", posed), ("hold", given.held)):
            if repeated := [name for name in names if names.count(name) > 1]:
                raise Refused(f"--{option} names `{repeated[0]}` more than once; expected each once")
        result = import_robot(**vars(given) | {"posture_deg": dict(given.posture_deg)})
        from jax_aero.robot.flight import report

        print(report(result))
        flights = [flight for flight in (result.hover, result.mission) if flight is not None]
        return 0 if result.trim.feasible and all(flight.outcome == "completed" for flight in flights) else 1

    return exit_status(work)


def _parser() -> Parser:
    parser = Parser("robot import", __doc__)
    add = parser.add_argument
    add("urdf", type=Path)
    add("--name", help="name of the robot and of its flights (default: that of the URDF)")
    add("--out", dest="folder", metavar="DIR", type=Path, help="folder for the files (default: results/robot/NAME)")
    lists: dict[str, Any] = {"action": "append", "default": []}
    add("--jet", dest="jets", required=True, type=thruster, metavar=THRUSTER, help="greatest thrust [N]", **lists)
    add("--foot", dest="feet", metavar="FRAME", help="sole frame, z up", **lists)
    add("--hold", dest="held", metavar="JOINT", help="a joint that stays as near to zero as it can", **lists)
    add("--hold-mimics", action="store_true", help="hold every joint that mimics another")
    add("--posture", dest="posture_deg", type=angle, metavar="JOINT=DEG", help="where the trim starts", **lists)
    add("--forward", choices=["x", "y", "-x", "-y"], default="x", help="forward axis of the base")
    add("--controller", choices=CONTROLLERS, default=CONTROLLERS[0], help="of configs/control, scaled to the robot")
    add("--skip-meshes", action="store_true", help="leave out meshes that are missing or cannot be read")
    add("--overwrite", action="store_true", help="replace the folder of an earlier import")
    add("--mission", dest="fly_mission", action="store_true", help="fly the paper's mission in 10 m/s of side wind too")
    return parser


def thruster(text: str) -> skeleton.Thruster:
    """Parse FRAME[:AXIS]:MAX[:MOMENT]; the axis is the direction of the force on the robot, by default -z."""
    parts = re.fullmatch(r"([^:]+)(?::(-?[xyz]))?:(\d+\.?\d*)(?::([-+]?\d+\.?\d*))?", text)
    if parts is None or float(parts[3]) == 0.0:
        axes = ", ".join(skeleton.AXES)
        expected = f"{THRUSTER} with an axis of {axes}, a thrust > 0 in N, and a rotor's moment about it in N m per N"
        raise argparse.ArgumentTypeError(f"`{text}`; expected {expected}")
    return skeleton.Thruster(parts[1], parts[2] or "-z", float(parts[3]), float(parts[4] or 0.0))


def angle(text: str) -> tuple[str, float]:
    """Parse JOINT=DEG, or for a prismatic joint JOINT=M."""
    joint, _, value = text.partition("=")
    with suppress(ValueError):
        if abs(degrees := float(value)) <= tables.LARGEST:
            return joint, degrees
    raise argparse.ArgumentTypeError(f"`{text}`; expected JOINT=DEG, e.g. l_elbow=30")


def import_robot(
    urdf: Path,
    folder: Path | None = None,
    *,
    name: str | None = None,
    jets: Sequence[skeleton.Thruster],
    feet: Sequence[str] = (),
    held: Sequence[str] = (),
    posture_deg: Mapping[str, float] | None = None,
    forward: str = "x",
    controller: str = CONTROLLERS[0],
    fly_mission: bool = False,
    hold_mimics: bool = False,
    skip_meshes: bool = False,
    overwrite: bool = False,
) -> ImportResult:
    """Write a robot's files into `folder`, and fly it; a refusal leaves no files there.

    The folder must be new or empty, or with `overwrite` that of an earlier import, which is replaced.
    """
    listing, posture_deg = read_urdf(urdf), posture_deg or {}
    name = name or listing.name or urdf.stem
    folder = folder or places.RESULTS / "robot" / places.file_name(name)
    is_import = (folder / "robot.toml").is_file()
    if folder.exists() and any(folder.iterdir()) and not (overwrite and is_import):
        raise Refused(
            f"{folder} is not empty; choose another --out{', or --overwrite the import' if is_import else ''}"
        )
    tree = skeleton.Tree(listing)
    tree.check_frames([jet.frame for jet in jets], feet, held)
    held = tree.with_mimics(held, hold_mimics=hold_mimics)
    joints = tree.moving(held)
    notes = masses.require(tree, joints)
    boxes = shapes.boxes(listing, urdf.parent, skip_meshes=skip_meshes)
    spinning = tree.spinning(jets, held)
    for warning in (
        *notes,
        *spinning,
        *skeleton.guessed(joints),
        *posture_doubts(joints, posture_deg),
        *masses.doubts(tree, boxes),
    ):
        warnings.warn(warning, stacklevel=2)
    height = max(START_HEIGHT, CLEARANCE - tree.lowest(boxes))
    with complete_folder(folder, replace=is_import) as draft:
        text = skeleton.write(
            tree, boxes, name=name, urdf=urdf, folder=draft, jets=jets, feet=feet, held=held, forward=forward
        )
        path = draft / "robot.toml"
        study.write_with_schema(path, "robot", text)
        try:
            rust.Robot(path)
            # Imported here, since JAX and CasADi take seconds, which the refusal of a URDF does not need.
            from jax_aero.robot import flight

            result = flight.fly(
                path,
                posture_deg=posture_deg,
                forward=forward,
                height=height,
                controller=controller,
                soles=feet,
                fly_mission=fly_mission,
            )
        except ValueError as reason:  # of a file that will not be there
            shown = str(reason).replace(f"{path}: ", "").replace(f"{draft}{os.sep}", "")
            # Rotors that spin make numbers of the controller absurd: what helps is no other number.
            raise Refused("; ".join([shown, *spinning])) from reason
    if result.growth is not None and not result.growth.stays:
        warnings.warn(f"the controller's copy {result.growth}: Controllers, a controller and its copy", stacklevel=2)
    return dataclasses.replace(result, folder=folder, unused=listing.unused)


def posture_doubts(joints: Sequence[Joint], posture_deg: Mapping[str, float]) -> list[str]:
    """Return warnings of positions outside the limits of their joints; refuse those of joints that do not move."""
    limits = {joint.name: skeleton.shown_limits(joint) for joint in joints}
    warnings = []
    for joint, position in posture_deg.items():
        if joint not in limits:
            raise Refused(f"--posture: `{joint}` is no joint that moves{places.did_you_mean(joint, limits)}")
        lower, upper, unit = limits[joint]
        if not lower <= position <= upper:
            reason = f"outside its limits, {lower:g} to {upper:g} {unit}: the trim starts at the nearest"
            warnings.append(f"--posture {joint}={position:g} is {reason}")
    return warnings
