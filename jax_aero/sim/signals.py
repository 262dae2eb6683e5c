"""The signals of a tick, as the crate logs them."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.body.spatial import rpy_from_rotation, wxyz_from_rotation
from jax_aero.control import Command, Measurement
from jax_aero.sim.plant import Observation, PlantState
from jax_aero.types import Array


class FlightRow(NamedTuple):
    """One tick of the log, with the signals and names of the Rust crate.

    Signals that a controller does not compute are NaN, as is everything that follows from a state that is not finite.
    Of what the crate's guard finds, the condition of joints is that of healthy ones, and latencies are not known.
    """

    time: Float[Array, ""]
    base_position: Float[Array, "3"]
    base_quaternion: Float[Array, "4"]
    base_velocity: Float[Array, "6"]
    base_rpy_setpoint: Float[Array, "3"]
    joint_position: Float[Array, " n"]
    joint_velocity: Float[Array, " n"]
    com_position: Float[Array, "3"]
    com_velocity: Float[Array, "3"]
    com_setpoint: Float[Array, "3"]
    rotation_error: Float[Array, ""]
    thrust: Float[Array, " j"]
    thrust_rate: Float[Array, " j"]
    joint_velocity_command: Float[Array, " n"]
    joint_torque: Float[Array, " n"]
    wind: Float[Array, "3"]
    aero_force_sim: Float[Array, "L 3"]
    aero_force_control: Float[Array, "L 3"]
    momentum: Float[Array, "6"]
    momentum_setpoint: Float[Array, "6"]
    momentum_rate_estimate: Float[Array, "6"]
    unmodelled_wrench: Float[Array, "6"]
    measured_base_position: Float[Array, "3"]
    measured_base_quaternion: Float[Array, "4"]
    measured_base_velocity: Float[Array, "6"]
    measured_joint_velocity: Float[Array, " n"]
    measured_thrust: Float[Array, " j"]
    measured_wind: Float[Array, "3"]
    measured_wind_std: Float[Array, "3"]
    raw_base_position: Float[Array, "3"]
    raw_base_rotation: Float[Array, "3 3"]
    raw_base_velocity: Float[Array, "6"]
    raw_joint_position: Float[Array, " n"]
    raw_joint_velocity: Float[Array, " n"]
    raw_thrust: Float[Array, " j"]
    raw_shaft_speed: Float[Array, " j"]
    raw_wind: Float[Array, "3"]
    qp_status: Float[Array, "2"]
    qp_kkt: Float[Array, "2"]
    qp_iterations: Float[Array, "2"]
    degraded_modes: Float[Array, ""]
    joint_condition: Float[Array, " n"]
    measured_torque_latency: Float[Array, ""]
    measured_thrust_latency: Float[Array, ""]


class Tick(NamedTuple):
    """What a tick has computed, for its row."""

    time: Float[Array, ""]
    """Time [s]."""
    wind: Float[Array, "3"]
    """True wind [m/s]."""
    plant: PlantState
    seen: Observation
    measurement: Measurement
    command: Command
    rotation_error: Float[Array, ""]
    """Angle between base and set-point [rad]; NaN without one."""


def record(tick: Tick) -> FlightRow:
    """Return the row of a tick."""
    time, wind, state, seen, raw, command, rotation_error = tick
    robot, momentum, mass = state.robot, seen.dynamics.momentum, seen.dynamics.mass_matrix[0, 0]
    setpoint, terms = command.setpoint, command.terms
    estimates, wind_std = (raw, jnp.zeros_like(wind)) if terms is None else (terms.estimates, terms.wind_std)
    answers = (command.momentum_qp, command.torque_qp)

    def unknown(like: Array) -> Array:
        return jnp.full_like(like, jnp.nan)

    def stack_answers(name: str, dtype: Any) -> Array:
        values = [jnp.nan if answer is None else getattr(answer, name) for answer in answers]
        return jnp.stack([jnp.asarray(value, dtype) for value in values])

    return FlightRow(
        time=time,
        base_position=robot.base_position,
        base_quaternion=wxyz_from_rotation(robot.base_rotation),
        base_velocity=robot.velocity[:6],
        base_rpy_setpoint=unknown(wind) if setpoint is None else rpy_from_rotation(setpoint.rotation),
        joint_position=robot.joint_position,
        joint_velocity=robot.velocity[6:],
        com_position=seen.kinematics.com,
        com_velocity=momentum[:3] / mass,
        com_setpoint=unknown(wind) if setpoint is None else setpoint.com_position,
        rotation_error=rotation_error,
        thrust=state.jets.thrust,
        thrust_rate=command.thrust_rate,
        joint_velocity_command=(
            unknown(command.joint_torque) if command.joint_velocity is None else command.joint_velocity
        ),
        joint_torque=command.joint_torque,
        wind=wind,
        aero_force_sim=seen.link_forces.forces,
        aero_force_control=unknown(seen.link_forces.forces) if terms is None else terms.link_forces.forces,
        momentum=momentum,
        momentum_setpoint=(
            unknown(momentum)
            if setpoint is None or terms is None
            else jnp.pad(terms.dynamics.mass_matrix[0, 0] * setpoint.com_velocity, (0, 3))
        ),
        momentum_rate_estimate=unknown(momentum) if terms is None else terms.momentum.rate_estimate,
        unmodelled_wrench=unknown(momentum) if terms is None else terms.momentum.unmodelled_wrench,
        measured_base_position=estimates.state.base_position,
        measured_base_quaternion=wxyz_from_rotation(estimates.state.base_rotation),
        measured_base_velocity=estimates.state.velocity[:6],
        measured_joint_velocity=estimates.state.velocity[6:],
        measured_thrust=estimates.thrust,
        measured_wind=estimates.wind,
        measured_wind_std=wind_std,
        raw_base_position=raw.state.base_position,
        raw_base_rotation=raw.state.base_rotation,
        raw_base_velocity=raw.state.velocity[:6],
        raw_joint_position=raw.state.joint_position,
        raw_joint_velocity=raw.state.velocity[6:],
        raw_thrust=raw.thrust,
        raw_shaft_speed=unknown(raw.thrust),
        raw_wind=raw.wind,
        qp_status=stack_answers("status", time.dtype),
        qp_kkt=stack_answers("kkt", time.dtype),
        qp_iterations=stack_answers("iterations", time.dtype),
        degraded_modes=jnp.asarray(jnp.nan if command.degraded_modes is None else command.degraded_modes, time.dtype),
        joint_condition=jnp.full_like(command.joint_torque, jnp.nan if terms is None else 0.0),
        measured_torque_latency=unknown(time),
        measured_thrust_latency=unknown(time),
    )


def record_divergence(time: Float[Array, ""], wind: Float[Array, "3"], state: PlantState, row: FlightRow) -> FlightRow:
    """Return the row of a tick whose state is not sound: of it, only what was integrated; all else is NaN."""
    robot = state.robot
    known = {
        "time": time,
        "wind": wind,
        "base_position": robot.base_position,
        "base_velocity": robot.velocity[:6],
        "joint_position": robot.joint_position,
        "joint_velocity": robot.velocity[6:],
        "thrust": state.jets.thrust,
    }
    return FlightRow(*(jnp.full_like(signal, jnp.nan) for signal in row))._replace(**known)
