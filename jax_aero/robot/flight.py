"""Trim an imported robot in still air, write its controller and flights, and fly them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jax_aero import memory, rust
from jax_aero.base import places
from jax_aero.base.result import ending
from jax_aero.body.robot import RobotModel
from jax_aero.body.robot import load_robot as load_twin
from jax_aero.body.spatial import rotation_from_rpy
from jax_aero.results import study
from jax_aero.robot import scenario, skeleton
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.robot import Array, Robot
from jax_aero.symbolic.trim import Trim, TrimResult, TrimSettings

HOVER, MISSION = "hover", "in_line"
TITLES = {HOVER: "hover in still air", MISSION: "the paper's mission in 10 m/s of side wind"}

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
    unused: Mapping[str, int] = dataclasses.field(default_factory=dict)
    """How often each tag of the URDF is there that is not used."""
    growth: memory.Growth | None = None
    """What becomes of a difference between the controller and its copy; `None` for a hover that is not completed."""


def fly(
    path: Path,
    *,
    posture_deg: Mapping[str, float],
    forward: str,
    height: float,
    controller: str,
    soles: Sequence[str],
    fly_mission: bool,
) -> ImportResult:
    """Fly the robot of a TOML file from a trim, if it has one, with the base at a height [m]; files are beside it."""
    folder, robot = path.parent, load_robot(path)
    trim = _trim(robot, posture_deg, forward)
    if not trim.feasible:
        return ImportResult(folder, trim, None, None)
    crate = rust.Robot(path)
    rotation = rotation_from_rpy(trim.base_rpy)
    dynamics = rust.dynamics(crate, rust.State.at_rest(crate, trim.joint_position)._replace(base_rotation=rotation))
    down = float(np.degrees(-np.arcsin(rotation[2] @ skeleton.AXES[forward])))
    twin = load_twin(path)
    free = scenario.joints_of_jets(twin)
    lean = float(np.degrees(greatest_lean(robot, free, trim.joint_position, trim.base_rpy, forward)))
    text = scenario.controller_text(controller, twin, dynamics, leans=(down, down + lean), soles=soles, folder=folder)
    study.write_with_schema(folder / "controller.toml", "control", text)

    def flight(name: str, mission: str, wind: str, duration: float) -> tuple[rust.Config, rust.FlightResult]:
        what = {"title": TITLES[mission], "mission": mission, "wind": wind}
        text = scenario.scenario_text(robot, trim, folder, **what, duration=duration, height=height)
        file = folder / f"{places.file_name(robot.name)}_{name}.toml"
        study.write_with_schema(file, "experiments", text)
        config = rust.load_config(file)
        return config, rust.fly(config)

    config, hover = flight("hover", HOVER, "still", 10.0)
    growth = memory.growth(config, hover.log) if hover.outcome == "completed" else None
    mission = flight("mission", MISSION, "lateral_ramp", 50.0)[1] if fly_mission else None
    return ImportResult(folder, trim, hover, mission, twin, growth=growth)


def _trim(robot: Robot, posture_deg: Mapping[str, float], forward: str) -> TrimResult:
    """Find the attitude and posture nearest to the given ones in which the thrusts balance the weight in still air."""
    units = [1.0 if joint.is_prismatic else np.pi / 180.0 for joint in robot.joints]
    named = zip(units, robot.joint_names, strict=True)
    wanted = np.array([unit * posture_deg.get(name, 0.0) for unit, name in named])
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
        hover = _solve(robot, free, posture, (roll, roll), (pitch, pitch), yaw, LEAN_RESERVE / 3.0, LEAN_RESERVE)
        if hover.feasible:
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
        MomentumModel(robot, {**rust.load_aero(scenario.AIR), "coefficients": scenario.COEFFICIENTS}), settings
    ).solve((0.0, 0.0, 0.0))


def report(result: ImportResult) -> str:
    """Return a report on the import."""
    trim = result.trim
    lines = [
        f"files                {result.folder}",
        f"trim                 {trim.message}; left over {np.abs(trim.residual).max():.1e} N or N m",
        f"thrust margin        {100.0 * trim.margin:.1f} %",
        "thrusts [N]          " + "  ".join(f"{thrust:.1f}" for thrust in trim.thrust),
    ]
    if not trim.feasible:
        crate = rust.Robot(result.folder / "robot.toml")
        lines.append(
            f"weight               {crate.mass * crate.gravity:.1f} N; greatest thrusts {sum(crate.thrust_max):.1f} N "
            "together, the axis in --jet FRAME:AXIS:MAX is the direction of the force on the robot"
        )
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
    if result.unused:
        lines.append("not used             " + ", ".join(f"{n} <{tag}>" for tag, n in result.unused.items()))
    return "\n".join(lines)


def limits_reached(flight: rust.FlightResult, robot: RobotModel) -> list[str]:
    """Return which torques and thrusts were at their limits for a fifth of the last three seconds of a flight."""
    last = flight["time"] > flight["time"][-1] - 3.0
    texts = []
    for signal, names, greatest in (
        ("joint_torque", robot.joint_names, robot.joint_torque_max),
        ("thrust", robot.jets.names, robot.jets.thrust_max),
    ):
        at_limit = (np.abs(flight[signal][last]) >= 0.999 * np.asarray(greatest)).mean(axis=0) > 0.2
        if reached := [name for name, at in zip(names, at_limit, strict=True) if at]:
            texts.append(f"{signal} at its limit: {', '.join(reached)}")
    return texts
