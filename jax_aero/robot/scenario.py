"""Files with which an imported robot flies: its controller and its scenarios."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.base import places, plain_values
from jax_aero.body.mirror import mirror_name
from jax_aero.body.robot import RobotModel
from jax_aero.symbolic.robot import Robot
from jax_aero.symbolic.trim import TrimResult

MASS, INERTIA, THRUST = 43.3, 6.66, 190.0
"""Mass [kg], trace of the centroidal inertia [kg m²] and mean greatest thrust [N] of the hovering iRonCub-Mk1, to which
the gains of `configs/control` belong."""

JOINT_MOMENTUM = 300.0
"""Weight of the angular-momentum task times the square of the joints' least share in it [kg² m⁴]; published: 57."""

FOLLOWING = {"kd": 60.0, "kp": 900.0}
"""Gains with which joints follow their velocities [1/s, 1/s²], critically damped: 0.6 of an error in a tick of 10 ms.
The published 20 and 100 give way to a push: a moment of 50 N m turns the waist of iRonCub-Mk3 by 20 degrees."""

JOINT_VELOCITY = 90.0
"""Greatest commanded velocity of a joint [deg/s]; published: 45."""

AIR, COEFFICIENTS = places.CONFIGS / "aero" / "axisymmetric_corrected.toml", "estimated"
"""Aerodynamic model of an imported robot, and the name of its force areas."""

RULES = f"""\
# A controller of configs/control for another robot. These values follow from the robot, of mass m, centroidal inertia I
# in the trim and mean greatest thrust T; all others are those of the controller:
#   momentum.c0, c1, also of the    times tr(I) / {INERTIA} kg m2
#     descent, its torque_rate_max;
#     disturbance_observer.moment_max
#   disturbance_observer.force_max  times m / {MASS} kg
#   fault_detection.engines         deviation_max times T / {THRUST:g} N
#   weights.momentum, symmetry,     times ({MASS} kg / m)^2, since they weigh squares of forces (per second)
#     thrust_rate; thrust_excess
#   weights.angular_momentum        {JOINT_MOMENTUM:g} / s^2; s: least singular value, above 1 % of the greatest, of the
#                                   matrix from joint velocities to angular momentum, kg m2
#   posture_gain                    20 1/s in every group
#   bounds.thrust_rate_max          half the greatest thrust per second; near a limit it fades out over twice the
#                                   thrust that it can change in a tick
#   joint_velocity_max_deg          {JOINT_VELOCITY:g}, or that of the slowest joint if it is less
#   torque                          kd 60 1/s, kp 900 1/s^2: with the published 20 and 100 the joints give way to a
#                                   push; the robot's own limits of torques and of their rates
#   setpoint.nose_down_limits_deg   from the pitch of the trim to the greatest lean from it, in steps of 5 deg up to the
#                                   published 30, with which it can hover, a fifth of every torque in reserve
#   mpc.joint_groups, posture       all groups, each with the weight of an arm
#   mpc.clearance                   none, unless the robot has links of these names
"""


def controller_text(
    name: str,
    robot: RobotModel,
    dynamics: rust.Dynamics,
    *,
    leans: tuple[float, float],
    soles: Collection[str],
    folder: Path,
) -> str:
    """Return the controller `configs/control/NAME.toml` for another robot by the `RULES`.

    Parameters
    ----------
    dynamics
        Those of the trim.
    leans
        Pitch of the heading frame, positive nose down, in the trim and as far as the robot can lean [deg].
    soles
        Frames of the feet.
    """
    table = controller(name, robot, dynamics, leans=leans, soles=soles)
    table["aero"] = {"base": _relative_path(AIR, folder), "coefficients": COEFFICIENTS}
    return f"{RULES}\n{plain_values.toml(table)}\n"


def controller(
    name: str, robot: RobotModel, dynamics: rust.Dynamics, *, leans: tuple[float, float], soles: Collection[str]
) -> dict[str, Any]:
    """Return the table of `controller_text`, without its air."""
    table = rust.load_controller(name)
    thrust_max = dict(zip(robot.jets.names, np.asarray(robot.jets.thrust_max).tolist(), strict=True))
    mass = float(np.asarray(robot.masses).sum())
    of_inertia, of_force = float(np.trace(dynamics.centroidal_inertia)) / INERTIA, (MASS / mass) ** 2
    weights, bounds = table["weights"], table["bounds"]

    pairs = [[jet, other] for jet in thrust_max if jet < (other := mirror_name(jet)) and other in thrust_max]
    weights |= {"thrust_rate": dict.fromkeys(thrust_max, 0.01 * of_force), "symmetric_jets": pairs}
    for key in ("momentum", "symmetry"):
        weights[key] *= of_force
    shares = np.linalg.svd(dynamics.momentum_matrix[3:, 6:], compute_uv=False)
    if shares.any():
        weights["angular_momentum"] = JOINT_MOMENTUM / float(shares[shares >= 0.01 * shares[0]].min()) ** 2
    table["posture_gain"] = {group: 20.0 for group, _ in robot.joint_groups}

    reach = {jet: 0.5 * greatest for jet, greatest in thrust_max.items()}
    bounds |= {"thrust_rate_max": reach, "thrust_steepness": 100.0 / max(reach.values(), default=100.0)}
    table["setpoint"]["nose_down_limits_deg"] = [*leans]

    engines = table["fault_detection"].get("engines") or {}
    descent = engines.get("descent", {})
    slowest = float(np.degrees(np.asarray(robot.joint_velocity_max)[robot.joint_turns > 0.0].min(initial=np.inf)))
    for limited in (bounds, descent) if descent else (bounds,):
        limited["joint_velocity_max_deg"] = min(JOINT_VELOCITY, slowest)
    table["torque"] |= FOLLOWING
    table["torque"].pop("torque_rate_max", None)
    if descent:
        descent["torque_rate_max"] *= of_inertia
    for gains in (table["momentum"], descent.get("momentum", {})):
        for key in gains.keys() & {"c0", "c1"}:
            gains[key] *= of_inertia
    if observer := table.get("disturbance_observer"):
        observer["force_max"] *= mass / MASS
        observer["moment_max"] *= of_inertia
    if engines:
        engines["deviation_max"] *= float(np.mean([*thrust_max.values()] or [0.0])) / THRUST
    if mpc := table.get("mpc"):
        _predictive(mpc, robot, of_force, soles)
    return table


def joints_of_jets(robot: RobotModel) -> tuple[int, ...]:
    """Return the indices of the joints that move a jet."""
    return tuple(map(int, np.flatnonzero(robot.ancestors[list(robot.jets.bodies)].any(axis=0))))


def _predictive(mpc: dict[str, Any], robot: RobotModel, of_force: float, soles: Collection[str]) -> None:
    """Change the predictive law by the rules."""
    mpc["joint_groups"] = [group for group, _ in robot.joint_groups]
    mpc["thrust_excess"] *= of_force
    for weights in (mpc["weights"], mpc["descent"]):
        weights["thrust_rate"] *= of_force
        weights["posture"] = dict.fromkeys(mpc["joint_groups"], weights["posture"]["left_arm"])
    known, clearance = {*robot.aero_links.names, *soles}, mpc["clearance"]
    clearance["apart_from"] = [link for link in clearance["apart_from"] if link in known]
    if not known.issuperset(clearance["links"]):
        del mpc["clearance"]


def scenario_text(
    robot: Robot,
    trim: TrimResult,
    folder: Path,
    *,
    title: str,
    mission: str,
    wind: str,
    duration: float,
    height: float,
) -> str:
    """Return a flight that starts in the trim, the base at a height [m], with the mission and wind of these names."""
    joints = ", ".join(repr(float(value)) for value in trim.joint_position)
    thrust = ", ".join(repr(float(value)) for value in trim.thrust)
    attitude = ", ".join(repr(float(value)) for value in np.degrees(trim.base_rpy))

    def path_of(kind: str, name: str) -> str:
        return plain_values.toml_value(_relative_path(places.CONFIGS / kind / f"{name}.toml", folder))

    return f"""title = {plain_values.toml_value(f"{robot.name}: {title}")}
description = "Starts in the trim that `jax-aero robot import` found."
robot = "robot.toml"
controller = {{ base = "controller.toml" }}
mission = {{ base = {path_of("mission", mission)} }}
wind = {{ base = {path_of("wind", wind)} }}

[simulator]
duration = {duration!r}
aero = {{ base = {path_of("aero", AIR.stem)}, coefficients = "estimated" }}
jets = {{ dynamics = "ideal" }}
fall = {{ rotation_error_deg = 90.0, com_error = 1.0 }}

[simulator.initial]                               # the trim in still air
base_position = [0.0, 0.0, {height!r}]
base_rpy_deg = [{attitude}]
joint_position = [{joints}]
thrust = [{thrust}]
free_fall_tick = false
"""


def _relative_path(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())
