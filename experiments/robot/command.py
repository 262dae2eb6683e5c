"""Import a robot: `jax-aero robot import URDF --jet FRAME[:AXIS]:MAX ... [--out DIR]`.

Writes a description of the robot from the URDF (base, joints in tree order with limits, groups by chain, jets,
aerodynamic links sized by the geometry, feet), checks it, trims the robot in still air, and flies it: a hover of ten
seconds and, with --mission, the paper's flight in 10 m/s of lateral wind. The user can refine all files in DIR:

    robot.toml  controller.toml  hover.toml  mission.toml      fly again with `jax-aero fly DIR/hover.toml`
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from experiments import Refused, study
from experiments.robot import scenario, shapes, skeleton
from jax_aero import places, rust, tables
from jax_aero.cli import Parser
from jax_aero.command import exit_status
from jax_aero.files import complete_folder
from jax_aero.result import ending
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.aero import load_aero
from jax_aero.symbolic.robot import Robot
from jax_aero.symbolic.trim import Trim, TrimResult, TrimSettings
from jax_aero.urdf import read_urdf

HOVER, MISSION = "hover", "in_line"


@dataclass(frozen=True)
class ImportResult:
    """Files and flights of an imported robot."""

    folder: Path
    trim: TrimResult
    hover: rust.FlightResult | None
    mission: rust.FlightResult | None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status: 1 if the robot has no trim or does not complete a flight."""
    given = _parser().parse_args(arguments)

    def work() -> int:
        for option, names in (("posture", [joint for joint, _ in given.posture]), ("hold", given.hold)):
            if repeated := [name for name in names if names.count(name) > 1]:
                raise Refused(f"--{option} names `{repeated[0]}` more than once; expected each joint once")
        result = import_robot(
            given.urdf,
            given.out or places.RESULTS / "robot" / given.urdf.stem,
            jets=given.jet,
            feet=given.foot,
            held=given.hold,
            posture_deg=dict(given.posture),
            forward=given.forward,
            fly_mission=given.mission,
        )
        print(report(result))
        flights = [flight for flight in (result.hover, result.mission) if flight is not None]
        return 0 if result.trim.feasible and all(flight.outcome == "completed" for flight in flights) else 1

    return exit_status(work)


def _parser() -> Parser:
    parser = Parser("robot import", __doc__)
    add = parser.add_argument
    add("urdf", type=Path)
    add("--out", type=Path, help="folder for the files (default: results/robot/URDF)")
    add("--jet", action="append", required=True, type=thruster, metavar="FRAME[:AXIS]:MAX", help="greatest thrust [N]")
    add("--foot", action="append", default=[], metavar="FRAME", help="sole frame, z up")
    add("--hold", action="append", default=[], metavar="JOINT", help="a joint that stays as near to zero as it can")
    add("--posture", action="append", default=[], type=angle, metavar="JOINT=DEG", help="where the trim starts")
    add("--forward", choices=["x", "y", "-x", "-y"], default="x", help="forward axis of the base")
    add("--mission", action="store_true", help="fly the paper's mission in 10 m/s of lateral wind as well")
    return parser


def thruster(text: str) -> skeleton.Thruster:
    """Parse FRAME[:AXIS]:MAX; the axis is the direction of the force on the robot, by default -z."""
    parts = re.fullmatch(r"([^:]+)(?::(-?[xyz]))?:(\d+\.?\d*)", text)
    if parts is None or float(parts[3]) == 0.0:
        expected = f"FRAME[:AXIS]:MAX with an axis of {', '.join(skeleton.AXES)} and a thrust > 0 in N"
        raise argparse.ArgumentTypeError(f"`{text}`; expected {expected}")
    return skeleton.Thruster(parts[1], parts[2] or "-z", float(parts[3]))


def angle(text: str) -> tuple[str, float]:
    """Parse JOINT=DEG, or for a prismatic joint JOINT=M."""
    joint, _, value = text.partition("=")
    with suppress(ValueError):
        if abs(degrees := float(value)) <= tables.LARGEST:
            return joint, degrees
    raise argparse.ArgumentTypeError(f"`{text}`; expected JOINT=DEG, e.g. l_elbow=30")


def import_robot(
    urdf: Path,
    folder: Path,
    *,
    jets: Sequence[skeleton.Thruster],
    feet: Sequence[str] = (),
    held: Sequence[str] = (),
    posture_deg: dict[str, float] | None = None,
    forward: str = "x",
    fly_mission: bool = False,
) -> ImportResult:
    """Write a robot's files into `folder`, which must be new or empty, and fly it; a refusal leaves no files there."""
    if folder.exists() and any(folder.iterdir()):
        raise Refused(f"{folder} is not empty; choose another --out")
    with complete_folder(folder) as draft:
        listing = read_urdf(urdf)
        tree = skeleton.Tree(listing)
        text = skeleton.write(
            tree,
            shapes.boxes(listing, urdf.parent),
            name=listing.name or urdf.stem,
            urdf=urdf,
            folder=draft,
            jets=jets,
            feet=feet,
            held=held,
            forward=forward,
        )
        path = _write(draft / "robot.toml", "robot", text)
        robot = load_robot(path)
        trim = _trim(robot, posture_deg or {}, forward)
        if not trim.feasible:
            return ImportResult(folder, trim, None, None)
        groups = [skeleton.group_name(chain) for chain in tree.chains(held)]
        text = scenario.controller_text(robot, groups, _inertia(path, trim), draft)
        _write(draft / "controller.toml", "control", text)
        hover = _fly(draft, robot, trim, "hover", mission=HOVER, wind="still", duration=10.0)
        mission = None
        if fly_mission:
            mission = _fly(draft, robot, trim, "mission", mission=MISSION, wind="lateral_ramp", duration=50.0)
        return ImportResult(folder, trim, hover, mission)


def _trim(robot: Robot, posture_deg: dict[str, float], forward: str) -> TrimResult:
    """Find the attitude and posture nearest to the given ones in which the thrusts balance the weight in still air."""
    if unknown := set(posture_deg) - set(robot.joint_names):
        raise Refused(f"`{min(unknown)}` is no joint of {robot.name}: {', '.join(robot.joint_names)}")
    wanted = np.zeros(robot.n_joints)
    for joint in robot.joints:
        if joint.index is not None:
            unit = 1.0 if joint.is_prismatic else np.pi / 180.0
            wanted[joint.index] = unit * posture_deg.get(robot.joint_names[joint.index], 0.0)
    # The base is rotated so that the robot faces +x.
    yaw = -float(np.arctan2(skeleton.AXES[forward][1], skeleton.AXES[forward][0]))
    settings = TrimSettings(
        posture=np.clip(wanted, *robot.joint_limits.T),
        free_joints=tuple(range(robot.n_joints)),
        roll=(-0.3, 0.3),
        pitch=(-0.5, 0.5),
        yaw=yaw,
        margin_min=0.05,
        torque_max=robot.joint_torque_max,
        clearance_min=-1.0,  # boxes around links are too coarse for the clearance of plumes
        plume_length=1.0,
        posture_weight=1.0,
        spread_weight=1.0,  # equal thrusts leave a reserve for the wind
    )
    return Trim(MomentumModel(robot, load_aero(places.CONFIGS / "aero" / "sphere_cylinder.toml")), settings).solve(
        (0.0, 0.0, 0.0)
    )


def _inertia(path: Path, trim: TrimResult) -> float:
    """Return the trace of the centroidal inertia in the trim [kg m²]."""
    joints = np.asarray(trim.joint_position)
    rotation = Rotation.from_euler("xyz", trim.base_rpy).as_matrix()
    state = rust.State(np.zeros(3), rotation, joints, np.zeros(6 + joints.size))
    return float(np.trace(rust.dynamics(rust.Robot(path), state).centroidal_inertia))


def _fly(
    folder: Path, robot: Robot, trim: TrimResult, name: str, *, mission: str, wind: str, duration: float
) -> rust.FlightResult:
    text = scenario.scenario_text(robot, trim, folder, mission=mission, wind=wind, duration=duration)
    return rust.fly(rust.load_config(_write(folder / f"{name}.toml", "experiments", text)))


def _write(path: Path, kind: str, text: str) -> Path:
    """Write a file whose first line names the schema of its kind, with which editors complete keys."""
    path.write_text(f"#:schema {study.schema_of(kind, path.parent)}\n{text}", encoding="utf-8")
    return path


def report(result: ImportResult) -> str:
    """Return a report on the import."""
    trim = result.trim
    lines = [
        f"files                {result.folder}",
        f"trim                 {trim.message}; left over {np.abs(trim.residual).max():.1e} N or N m",
        f"thrust margin        {100.0 * trim.margin:.1f} %",
        "thrusts [N]          " + "  ".join(f"{thrust:.1f}" for thrust in trim.thrust),
    ]
    for name, flight in (("hover", result.hover), ("mission", result.mission)):
        if flight is None:
            continue
        lines.append(
            f"{name:<20} {ending(flight.outcome, flight.lost_time, flight.lost_reason)}; "
            f"CoM within {1000.0 * flight.summary['max_com_error']:.1f} mm, "
            f"attitude within {np.degrees(flight.summary['max_rotation_error']):.2f} deg"
        )
    return "\n".join(lines)
