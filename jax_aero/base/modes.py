"""Modes of a tick: what was not measured, and how the robot flies without it."""

from __future__ import annotations

MODES = {
    "wind_held": 1,
    "wind_lost": 2,
    "thrust_modelled": 4,
    "joints_predicted": 8,
    "position_predicted": 16,
    "rotation_predicted": 32,
    "velocity_predicted": 64,
    "feet_predicted": 128,
    "clock_predicted": 256,
    "descending": 512,
    "engine_limited": 1024,
    "begun_again": 2048,
    "joint_limited": 4096,
    "straying": 16384,
    "residual_ignored": 32768,
    "late": 65536,
}
"""Bits of a tick's modes, as in the Rust crate; a flight of JAX has `residual_ignored` alone."""
