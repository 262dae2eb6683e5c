"""Files with which an imported robot flies: its controller and its scenarios."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jax_aero import places, tables
from jax_aero.mirror import mirror_name
from jax_aero.symbolic.robot import Robot
from jax_aero.symbolic.trim import TrimResult

INERTIA_OF_PUBLISHED_GAINS = 6.66
"""Trace of the centroidal inertia of the hovering iRonCub-Mk1, for which c0 and c1 were published [kg m²]."""


def controller_text(robot: Robot, groups: Sequence[str], inertia: float, folder: Path) -> str:
    """Return the published controller for another robot: its jets and groups, attitude gains scaled by inertia."""
    table = tables.read(places.CONFIGS / "control" / "aero_aware.toml")
    reach = {jet.name: 0.5 * jet.thrust_max for jet in robot.jets}
    table["aero"] = {"base": _relative_path(places.CONFIGS / "aero" / "sphere_cylinder.toml", folder)}
    for key in ("c0", "c1"):
        table["momentum"][key] *= inertia / INERTIA_OF_PUBLISHED_GAINS
    table["posture_gain"] = dict.fromkeys(groups, 20.0)
    pairs = [[name, other] for name in reach if name < (other := mirror_name(name)) and other in reach]
    table["weights"] |= {"thrust_rate": dict.fromkeys(reach, 0.01), "symmetric_jets": pairs}
    # Slower joints than published, since the robot is not tuned yet.
    table["weights"]["joint_velocity"] = 40.0
    table["torque"] |= {"kd": 10.0, "kp": 25.0}
    # Half the greatest thrust per second; near a limit the rate fades out over the thrust that one tick can change.
    table["bounds"] |= {"thrust_rate_max": reach, "thrust_steepness": 100.0 / max(reach.values(), default=100.0)}
    about = "# Controller: configs/control/aero_aware.toml for the robot's jets and joints."
    return f"{about}\n{tables.toml(table)}\n"


def scenario_text(robot: Robot, trim: TrimResult, folder: Path, *, mission: str, wind: str, duration: float) -> str:
    """Return a flight that starts in the trim, with the project's mission and wind of these names."""
    joints = ", ".join(repr(float(value)) for value in trim.joint_position)
    thrust = ", ".join(repr(float(value)) for value in trim.thrust)
    attitude = ", ".join(repr(float(value)) for value in np.degrees(trim.base_rpy))

    def path_of(kind: str, name: str) -> str:
        return tables.toml_value(_relative_path(places.CONFIGS / kind / f"{name}.toml", folder))

    return f"""title = {tables.toml_value(f"{robot.name}: {mission} in wind {wind}")}
description = "Starts in the trim that import-robot found."
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
