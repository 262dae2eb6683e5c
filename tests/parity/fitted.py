"""Flights of iRonCub-Mk1, fitted to the names and lengths of another robot."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.rust import Robot


def fitted(experiment: str, path: Path, aero: Mapping[str, Any]) -> tuple[Robot, rust.Config]:
    """Return the robot and the configuration of an experiment for it, with one aerodynamic model on both sides."""
    robot, config = Robot(path), rust.load_config(experiment)
    config["robot"] = os.fspath(path)
    config["simulator"]["aero"] = config["controller"]["aero"] = aero
    config["simulator"]["initial"] |= {
        "joint_position": [0.0] * len(robot.joint_names),
        "thrust": [0.0] * len(robot.jet_names),
    }
    controller = config["controller"]
    controller["posture_gain"] = dict.fromkeys(robot.joint_groups, 20.0)
    controller["weights"] |= {"thrust_rate": dict.fromkeys(robot.jet_names, 0.01), "symmetric_jets": []}
    controller["bounds"]["thrust_rate_max"] = dict.fromkeys(robot.jet_names, 100.0)
    return robot, config
