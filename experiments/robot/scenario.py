"""Files with which an imported robot flies: its controller and its scenarios."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jax_aero import places, rust, tables
from jax_aero.mirror import mirror_name
from jax_aero.symbolic.robot import Array, Robot
from jax_aero.symbolic.trim import TrimResult

MASS, INERTIA = 43.3, 6.66
"""Mass [kg] and trace of the centroidal inertia [kg m²] of the hovering iRonCub-Mk1, for which gains are published."""

JOINT_MOMENTUM = 300.0
"""Weight of the angular-momentum task times the square of the joints' least share in it [kg² m⁴]; published: 57."""

RULES = f"""\
# The controller of configs/control/aero_aware.toml for another robot. These values follow from the robot, of mass m and
# centroidal inertia I in the trim; all others are the published ones:
#   momentum.c0, c1                 published times tr(I) / {INERTIA} kg m2
#   weights.momentum, symmetry,     published times ({MASS} kg / m)^2, since they weigh squares of forces per second
#     thrust_rate
#   weights.angular_momentum        {JOINT_MOMENTUM:g} / s^2; s: least singular value, above 1 % of the greatest, of the
#                                   matrix from joint velocities to angular momentum, kg m2
#   posture_gain                    20 1/s in every group
#   bounds.thrust_rate_max          half the greatest thrust per second; near a limit it fades out over twice the
#                                   thrust that it can change in a tick
#   bounds.joint_velocity_max_deg   published, or that of the slowest joint if it is less
#   torque                          the robot's own limits of torques and of their rates
#   setpoint.nose_down_limits_deg   published, counted from the pitch of the trim
"""


def controller_text(
    robot: Robot,
    groups: Sequence[str],
    dynamics: rust.Dynamics,
    *,
    nose_down: float,
    velocity_max: Array,
    folder: Path,
) -> str:
    """Return the published controller for another robot by the `RULES`.

    Parameters
    ----------
    dynamics
        Those of the trim.
    nose_down
        Pitch of the heading frame in the trim, positive nose down [rad].
    velocity_max
        (n,) greatest velocities of the joints [rad/s, m/s].
    """
    table = tables.read(places.CONFIGS / "control" / "aero_aware.toml")
    reach = {jet.name: 0.5 * jet.thrust_max for jet in robot.jets}
    table["aero"] = {"base": _relative_path(places.CONFIGS / "aero" / "sphere_cylinder.toml", folder)}
    for key in ("c0", "c1"):
        table["momentum"][key] *= float(np.trace(dynamics.centroidal_inertia)) / INERTIA
    table["posture_gain"] = dict.fromkeys(groups, 20.0)

    weights, of_force = table["weights"], (MASS / robot.mass) ** 2
    pairs = [[name, other] for name in reach if name < (other := mirror_name(name)) and other in reach]
    weights |= {"thrust_rate": dict.fromkeys(reach, 0.01 * of_force), "symmetric_jets": pairs}
    for key in ("momentum", "symmetry"):
        weights[key] *= of_force
    shares = np.linalg.svd(dynamics.momentum_matrix[3:, 6:], compute_uv=False)
    if shares.any():
        weights["angular_momentum"] = JOINT_MOMENTUM / float(shares[shares >= 0.01 * shares[0]].min()) ** 2

    bounds, setpoint = table["bounds"], table["setpoint"]
    turning = [joint.index for joint in robot.joints if joint.index is not None and not joint.is_prismatic]
    slowest = float(np.degrees(velocity_max[turning].min(initial=np.inf)))
    bounds["joint_velocity_max_deg"] = min(bounds["joint_velocity_max_deg"], slowest)
    bounds |= {"thrust_rate_max": reach, "thrust_steepness": 100.0 / max(reach.values(), default=100.0)}
    del table["torque"]["torque_rate_max"]
    limits = [limit + float(np.degrees(nose_down)) for limit in setpoint["nose_down_limits_deg"]]
    setpoint["nose_down_limits_deg"] = limits
    return f"{RULES}\n{tables.toml(table)}\n"


def scenario_text(robot: Robot, trim: TrimResult, folder: Path, *, mission: str, wind: str, duration: float) -> str:
    """Return a flight that starts in the trim, with the project's mission and wind of these names."""
    joints = ", ".join(repr(float(value)) for value in trim.joint_position)
    thrust = ", ".join(repr(float(value)) for value in trim.thrust)
    attitude = ", ".join(repr(float(value)) for value in np.degrees(trim.base_rpy))

    def path_of(kind: str, name: str) -> str:
        return tables.toml_value(_relative_path(places.CONFIGS / kind / f"{name}.toml", folder))

    return f"""title = {tables.toml_value(f"{robot.name}: {mission} in wind {wind}")}
description = "Starts in the trim that `jax-aero robot import` found."
robot = "robot.toml"
controller = {{ base = "controller.toml" }}
mission = {{ base = {path_of("mission", mission)} }}
wind = {{ base = {path_of("wind", wind)} }}

[simulator]
duration = {duration!r}
time_step = 0.01
aero = {{ base = {path_of("aero", "sphere_cylinder")} }}
jets = {{ dynamics = "ideal" }}
fall = {{ rotation_error_deg = 90.0, com_error = 1.0 }}

[simulator.initial]                               # the trim in still air
base_position = [0.0, 0.0, 1.0]
base_rpy_deg = [{attitude}]
joint_position = [{joints}]
thrust = [{thrust}]
free_fall_tick = false
"""


def _relative_path(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())
