"""Joints and links of iRonCub in the public tables, and of those of this project."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jax_aero import rust
from jax_aero.aero.dataset import reorder_joints
from jax_aero.body.robot import RobotModel

JOINTS = (
    *("torso_pitch", "torso_roll", "torso_yaw"),
    *("l_shoulder_pitch", "l_shoulder_roll", "l_shoulder_yaw", "l_elbow"),
    *("r_shoulder_pitch", "r_shoulder_roll", "r_shoulder_yaw", "r_elbow"),
    *("l_hip_pitch", "l_hip_roll", "l_hip_yaw", "l_knee"),
    *("r_hip_pitch", "r_hip_roll", "r_hip_yaw", "r_knee"),
)
"""Joints that influence the flow: all but the ankles, in the order of every table."""

LINKS = (
    *("head", "chest", "chest_l_jet_turbine", "chest_r_jet_turbine"),
    *("l_upper_arm", "l_arm_jet_turbine", "r_upper_arm", "r_arm_jet_turbine"),
    *("root_link", "l_upper_leg", "l_lower_leg", "r_upper_leg", "r_lower_leg"),
)
"""Links of iRonCub-Mk1 and of every public table, in the order of the robot's configuration."""


def joint_position(
    robot: RobotModel | rust.Robot, joint_position_deg: Float[np.ndarray, "*batch 19"]
) -> Float[np.ndarray, "*batch n"]:
    """Return the robot's joint positions [rad] from angles of the tables [deg]; those of the ankles are zero."""
    return reorder_joints(robot.joint_names, JOINTS, joint_position_deg)
