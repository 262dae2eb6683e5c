"""Files and limits of the golden states."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILE = Path(__file__).parent / "states.json"
ROBOT = ROOT / "configs/robot/ironcub_mk1.toml"
TORQUE_MAX = 50.0
"""Torque limit of every joint [N m], as published; the robot's own limits are other ones."""
EXPERIMENT = ROOT / "configs/experiments/test2.toml"
AERO = {
    "aero_aware": ROOT / "configs/aero/axisymmetric_published.toml",
    "sphere_cylinder": ROOT / "configs/aero/sphere_cylinder.toml",
}
