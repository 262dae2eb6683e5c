"""The signals of a tick, as the crate logs them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero import rust
from jax_aero.body.spatial import rpy_from_rotation, wxyz_from_rotation
from jax_aero.control import Command, Measurement
from jax_aero.sim.plant import Observation, PlantState
from jax_aero.types import Array

FlightRow: TypeAlias = dict[str, Array]
"""One tick of the log: the signals of `rust.signals` that are computed, which depends on the controller.

All that follows from a state that is not finite is NaN. `complete` makes signals that are not computed NaN in the log,
as compiled code without NaN is what `jax_debug_nans` demands. Of what fault detection finds, the condition of joints
is that of healthy ones, and latencies are not known.
"""


def record(
    time: Float[Array, ""],
    wind: Float[Array, "3"],
    state: PlantState,
    seen: Observation,
    raw: Measurement,
    command: Command,
    rotation_error: Float[Array, ""] | None,
) -> FlightRow:
    """Return the row of a tick at `time` [s], in the true wind [m/s], of what was measured (`raw`) and commanded.

    `rotation_error` is the angle between base and set-point [rad], if there is one.
    """
    robot, momentum, mass = state.robot, seen.dynamics.momentum, seen.dynamics.mass_matrix[0, 0]
    setpoint, terms = command.setpoint, command.terms
    estimates, wind_std = (raw, jnp.zeros_like(wind)) if terms is None else (terms.estimates, terms.wind_std)
    row = {
        "time": time,
        "base_position": robot.base_position,
        "base_quaternion": wxyz_from_rotation(robot.base_rotation),
        "base_velocity": robot.velocity[:6],
        "joint_position": robot.joint_position,
        "joint_velocity": robot.velocity[6:],
        "com_position": seen.kinematics.com,
        "com_velocity": momentum[:3] / mass,
        "thrust": state.jets.thrust,
        "thrust_rate": command.thrust_rate,
        "joint_torque": command.joint_torque,
        "wind": wind,
        "aero_force_sim": seen.link_forces.forces,
        "momentum": momentum,
        "measured_base_position": estimates.state.base_position,
        "measured_base_quaternion": wxyz_from_rotation(estimates.state.base_rotation),
        "measured_base_velocity": estimates.state.velocity[:6],
        "measured_joint_velocity": estimates.state.velocity[6:],
        "measured_thrust": estimates.thrust,
        "measured_wind": estimates.wind,
        "measured_wind_std": wind_std,
        "raw_base_position": raw.state.base_position,
        "raw_base_rotation": raw.state.base_rotation,
        "raw_base_velocity": raw.state.velocity[:6],
        "raw_joint_position": raw.state.joint_position,
        "raw_joint_velocity": raw.state.velocity[6:],
        "raw_thrust": raw.thrust,
        "raw_wind": raw.wind,
    }
    if command.momentum_qp is not None and command.torque_qp is not None:
        for name in ("status", "kkt", "iterations"):
            answers = [getattr(answer, name) for answer in (command.momentum_qp, command.torque_qp)]
            row[f"qp_{name}"] = jnp.stack([jnp.asarray(answer, time.dtype) for answer in answers])
    if rotation_error is not None:
        row["rotation_error"] = rotation_error
    if command.joint_velocity is not None:
        row["joint_velocity_command"] = command.joint_velocity
    if command.degraded_modes is not None:
        row["degraded_modes"] = jnp.asarray(command.degraded_modes, time.dtype)
    if setpoint is not None:
        row["base_rpy_setpoint"] = rpy_from_rotation(setpoint.rotation)
        row["com_setpoint"] = setpoint.com_position
    if terms is not None:
        row["aero_force_control"] = terms.link_forces.forces
        row["momentum_rate_estimate"] = terms.momentum.rate_estimate
        row["unmodelled_wrench"] = terms.momentum.unmodelled_wrench
        row["joint_condition"] = jnp.zeros_like(command.joint_torque)
    if setpoint is not None and terms is not None:
        row["momentum_setpoint"] = jnp.pad(terms.dynamics.mass_matrix[0, 0] * setpoint.com_velocity, (0, 3))
    return row


def complete(log: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the log of a flight with NaN for the signals that were not computed, in the order of `rust.signals`."""
    sizes = {
        "xyz": 3,
        "base_axis": 3,
        "rpy": 3,
        "wxyz": 4,
        "six": 6,
        "qp": 2,
        "joint": log["joint_position"].shape[-1],
        "jet": log["thrust"].shape[-1],
        "link": log["aero_force_sim"].shape[-2],
    }
    shapes = {
        name: (len(log["time"]), *(sizes[dim] for dim in signal.dims[1:]))
        for name, signal in rust.signals().items()
        if signal.dims[0] == "time" and not signal.is_of_ground
    }
    return {name: log[name] if name in log else np.full(shape, np.nan) for name, shape in shapes.items()}


def record_divergence(time: Float[Array, ""], wind: Float[Array, "3"], state: PlantState, row: FlightRow) -> FlightRow:
    """Return the row of a tick whose state is not sound: of it, only what was integrated; all else is NaN."""
    robot = state.robot
    return {name: jnp.full_like(signal, jnp.nan) for name, signal in row.items()} | {
        "time": time,
        "wind": wind,
        "base_position": robot.base_position,
        "base_velocity": robot.velocity[:6],
        "joint_position": robot.joint_position,
        "joint_velocity": robot.velocity[6:],
        "thrust": state.jets.thrust,
    }
