"""Import a robot: `jax-aero robot import URDF --jet FRAME[:AXIS]:MAX[:MOMENT] ... [--name NAME] [--out DIR]`.

Writes a description of the robot from the URDF (base, joints in tree order with limits, groups by chain, jets,
aerodynamic links sized by the geometry, feet), checks it, trims the robot in still air, and flies it: a hover of ten
seconds and, with --mission, the paper's flight in 10 m/s of lateral wind. The user can refine all files in DIR:

    robot.toml  controller.toml  NAME_hover.toml  NAME_mission.toml    fly again with `jax-aero fly DIR/NAME_hover.toml`
"""

from __future__ import annotations

import argparse
import dataclasses
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
from jax_aero.robot import RobotModel
from jax_aero.robot import load_robot as load_twin
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.aero import load_aero
from jax_aero.symbolic.robot import Array, Robot
from jax_aero.symbolic.trim import Trim, TrimResult, TrimSettings
from jax_aero.urdf import read_urdf

HOVER, MISSION = "hover", "in_line"
CONTROLLERS = ("mpc", "observer", "aero_aware")
THRUSTER = "FRAME[:AXIS]:MAX[:MOMENT]"
"""Those of `configs/control` that can be scaled to a robot; the first is the default."""

RESERVE = 0.05
"""Least distance of thrusts, joint positions and torques in the trim from their limits, relative to their ranges."""

LEANS, LEAN_RESERVE = (30.0, 25.0, 20.0, 15.0, 10.0, 5.0), 0.2
"""Forward leans from the trim that are tried [deg], and their reserve of torques; that of thrusts is a third of it."""


@dataclass(frozen=True)
class ImportResult:
    """Files and flights of an imported robot."""

    folder: Path
    trim: TrimResult
    hover: rust.FlightResult | None
    mission: rust.FlightResult | None
    robot: RobotModel | None = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status: 1 if the robot has no trim or does not complete a flight."""
    given = _parser().parse_args(arguments)

    def work() -> int:
        for option, names in (("posture", [joint for joint, _ in given.posture]), ("hold", given.hold)):
            if repeated := [name for name in names if names.count(name) > 1]:
                raise Refused(f"--{option} names `{repeated[0]}` more than once; expected each joint once")
        result = import_robot(
            given.urdf,
            given.out,
            name=given.name,
            jets=given.jet,
            feet=given.foot,
            held=given.hold,
            posture_deg=dict(given.posture),
            forward=given.forward,
            controller=given.controller,
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
    add("--name", help="name of the robot and of its flights (default: that of the URDF)")
    add("--out", type=Path, help="folder for the files (default: results/robot/NAME)")
    add("--jet", action="append", required=True, type=thruster, metavar=THRUSTER, help="greatest thrust [N]")
    add("--foot", action="append", default=[], metavar="FRAME", help="sole frame, z up")
    add("--hold", action="append", default=[], metavar="JOINT", help="a joint that stays as near to zero as it can")
    add("--posture", action="append", default=[], type=angle, metavar="JOINT=DEG", help="where the trim starts")
    add("--forward", choices=["x", "y", "-x", "-y"], default="x", help="forward axis of the base")
    add("--controller", choices=CONTROLLERS, default=CONTROLLERS[0], help="of configs/control, scaled to the robot")
    add("--mission", action="store_true", help="fly the paper's mission in 10 m/s of lateral wind as well")
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
    posture_deg: dict[str, float] | None = None,
    forward: str = "x",
    controller: str = CONTROLLERS[0],
    fly_mission: bool = False,
) -> ImportResult:
    """Write a robot's files into `folder`, which must be new or empty, and fly it; a refusal leaves no files there."""
    listing = read_urdf(urdf)
    name = name or listing.name or urdf.stem
    folder = folder or places.RESULTS / "robot" / places.file_name(name)
    if folder.exists() and any(folder.iterdir()):
        raise Refused(f"{folder} is not empty; choose another --out")
    with complete_folder(folder) as draft:
        tree = skeleton.Tree(listing)
        text = skeleton.write(
            tree,
            shapes.boxes(listing, urdf.parent),
            name=name,
            urdf=urdf,
            folder=draft,
            jets=jets,
            feet=feet,
            held=held,
            forward=forward,
        )
        path = _write(draft / "robot.toml", "robot", text)
        crate, robot = rust.Robot(path), load_robot(path)
        trim = _trim(robot, posture_deg or {}, forward)
        if not trim.feasible:
            return ImportResult(folder, trim, None, None)
        rotation = Rotation.from_euler("xyz", trim.base_rpy).as_matrix()
        dynamics = rust.dynamics(crate, rust.State.at_rest(crate, trim.joint_position)._replace(base_rotation=rotation))
        down = float(np.degrees(-np.arcsin(rotation[2] @ skeleton.AXES[forward])))
        twin = load_twin(path)
        free = scenario.joints_of_jets(twin)
        lean = float(np.degrees(greatest_lean(robot, free, trim.joint_position, trim.base_rpy, forward)))
        leans = (down, down + lean)
        text = scenario.controller_text(controller, twin, dynamics, leans=leans, soles=feet, folder=draft)
        _write(draft / "controller.toml", "control", text)
        hover = _fly(draft, robot, trim, "hover", mission=HOVER, wind="still", duration=10.0)
        mission = None
        if fly_mission:
            mission = _fly(draft, robot, trim, "mission", mission=MISSION, wind="lateral_ramp", duration=50.0)
        return ImportResult(folder, trim, hover, mission, twin)


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
    lower, upper = robot.joint_limits.T
    inner = np.stack([lower, upper], axis=1) + RESERVE * np.outer(upper - lower, [1.0, -1.0])
    robot = dataclasses.replace(robot, joint_limits=inner)
    return _solve(
        robot, tuple(range(robot.n_joints)), np.clip(wanted, *inner.T), (-0.3, 0.3), (-0.5, 0.5), yaw, RESERVE, RESERVE
    )


def greatest_lean(robot: Robot, free: tuple[int, ...], posture: Array, base_rpy: Array, forward: str) -> float:
    """Return the greatest of the `LEANS` from an attitude with which the robot hovers [rad]; 0 for none.

    The joints that move jets are free, the others stay in the posture.
    """
    x, y, _ = skeleton.AXES[forward]
    for lean in np.radians(LEANS):
        roll, pitch, yaw = (float(angle) for angle in base_rpy + lean * np.array([-y, x, 0.0]))
        found = _solve(robot, free, posture, (roll, roll), (pitch, pitch), yaw, LEAN_RESERVE / 3.0, LEAN_RESERVE)
        if found.feasible:
            return float(lean)
    return 0.0


def _solve(
    robot: Robot,
    free: tuple[int, ...],
    posture: Array,
    roll: tuple[float, float],
    pitch: tuple[float, float],
    yaw: float,
    thrust_reserve: float,
    torque_reserve: float,
) -> TrimResult:
    settings = TrimSettings(
        posture=posture,
        free_joints=free,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        margin_min=thrust_reserve,
        torque_max=(1.0 - torque_reserve) * robot.joint_torque_max,
        clearance_min=-1.0,  # boxes around links are too coarse for the clearance of plumes
        plume_length=1.0,
        posture_weight=1.0,
        spread_weight=1.0,  # equal thrusts leave a reserve for the wind
    )
    return Trim(
        MomentumModel(robot, {**load_aero(scenario.AIR), "coefficients": scenario.COEFFICIENTS}), settings
    ).solve((0.0, 0.0, 0.0))


def _fly(
    folder: Path, robot: Robot, trim: TrimResult, name: str, *, mission: str, wind: str, duration: float
) -> rust.FlightResult:
    text = scenario.scenario_text(robot, trim, folder, mission=mission, wind=wind, duration=duration)
    path = folder / f"{places.file_name(robot.name)}_{name}.toml"
    return rust.fly(rust.load_config(_write(path, "experiments", text)))


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
        line = f"{name:<20} {ending(flight.outcome, flight.lost_time, flight.lost_reason)}"
        if not np.isnan(flight.summary["max_com_error"]):  # of a flight that lasted until it has settled
            line += f"; CoM within {1000.0 * flight.summary['max_com_error']:.1f} mm"
        line += f"; attitude within {np.degrees(flight.summary['max_rotation_error']):.2f} deg"
        if result.robot is not None and flight.lost_time is not None:
            line += "".join(f"; {reached}" for reached in limits_reached(flight, result.robot))
        lines.append(line)
    return "\n".join(lines)


def limits_reached(flight: rust.FlightResult, robot: RobotModel) -> list[str]:
    """Return which torques and thrusts were at their limits for a fifth of the last three seconds of a flight."""
    last = flight["time"] > flight["time"][-1] - 3.0
    found = []
    for signal, names, greatest in (
        ("joint_torque", robot.joint_names, robot.joint_torque_max),
        ("thrust", robot.jets.names, robot.jets.thrust_max),
    ):
        at_limit = (np.abs(flight[signal][last]) >= 0.999 * np.asarray(greatest)).mean(axis=0) > 0.2
        if reached := [name for name, at in zip(names, at_limit, strict=True) if at]:
            found.append(f"{signal} at its limit: {', '.join(reached)}")
    return found
