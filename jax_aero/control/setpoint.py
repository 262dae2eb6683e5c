"""Smooth set-points of centre of mass and attitude, with derivatives, from autopilot commands.

Call `start` once, then `update` once per tick; the state is a pytree for `lax.scan`. All operations except the turbo
counter are floating-point, so set-points can be differentiated with respect to speeds, gains and smoothing times. The
raw attitude is that of the heading frame: forward, left, up, fixed to the base by the robot's forward axis.

Equations M43 to M48, M107 and M115 of `docs/model.md`. Source: the published flight-control library.
"""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero.config import MissionConfig, SetpointConfig
from jax_aero.control.recorded import RecordedMotion, Recording, motion_at
from jax_aero.spatial import (
    cross,
    multiply,
    project_to_so3,
    rotation_from_rpy,
    rpy_from_rotation,
    safe_norm,
    skew,
    vee_of_skew_part,
)
from jax_aero.types import Array, Setpoint, leaf, pytree

# --- autopilot ----------------------------------------------------------------------------------------------------


class AutopilotCommand(NamedTuple):
    """Commands of one tick: -1, 0 or 1 in the robot's forward, left, up axes."""

    forward: Float[Array, ""]
    vertical: Float[Array, ""]
    nose_down: Float[Array, ""]
    """Rotation about the left axis."""
    yaw: Float[Array, ""]
    """Rotation about the vertical, positive to the left."""
    turbo: Bool[Array, ""]
    """Whether the forward speed is boosted."""


@pytree
class Commands:
    """Commands of the autopilot: for each motion, open intervals (k, 2) of time [s]."""

    up: Float[Array, "_ 2"]
    down: Float[Array, "_ 2"]
    forward: Float[Array, "_ 2"]
    forward_turbo: Float[Array, "_ 2"]
    pitch_up: Float[Array, "_ 2"]
    yaw_left: Float[Array, "_ 2"]


def commands(mission: MissionConfig) -> Commands:
    """Return the commands of a configured mission."""
    lists = {item.name: leaf(getattr(mission, item.name)) for item in fields(Commands)}
    return Commands(**{name: intervals.reshape(-1, 2) for name, intervals in lists.items()})


def autopilot_command(mission: Commands, time: Float[Array, ""]) -> AutopilotCommand:
    """Return the command at `time` [s]; a command is active inside its open intervals."""
    time = jnp.asarray(time)
    # A tick at the end of an interval is outside; the margin prevents rounding of k · 0.01 from moving it inside.
    margin = jnp.maximum(1e-9, 4.0 * float(np.finfo(time.dtype).eps) * jnp.abs(time))

    def is_active(intervals: Array) -> Array:
        return jnp.any((time > intervals[:, 0] + margin) & (time < intervals[:, 1] - margin))

    def flag(intervals: Array) -> Array:
        return is_active(intervals).astype(time.dtype)

    turbo = is_active(mission.forward_turbo)
    return AutopilotCommand(
        forward=(turbo | is_active(mission.forward)).astype(time.dtype),
        vertical=flag(mission.up) - flag(mission.down),
        nose_down=-flag(mission.pitch_up),
        yaw=flag(mission.yaw_left),
        turbo=turbo,
    )


# --- minimum-jerk filter ------------------------------------------------------------------------------------------

# Coefficients of the linear minimum-jerk trajectory generator of the iCub control library; the denominator has one
# real pole of multiplicity three at -5.3223/T.
_A, _B, _C = 150.765868956161, 84.9812819469538, 15.9669610709384


class FilterGains(NamedTuple):
    """A minimum-jerk filter discretised for a fixed tick."""

    transition: Float[Array, "3 3"]
    input_gain: Float[Array, "3"]


class FilterState(NamedTuple):
    """Value, first and second derivative of three axes, and the input of the previous tick."""

    derivatives: Float[Array, "3 3"]
    previous_input: Float[Array, "3"]


@jax.jit  # otherwise each operation would be compiled separately
def filter_gains(smoothing_time: Float[Array, ""], time_step: Float[Array, ""]) -> FilterGains:
    """Discretise `H(s) = (A/T³) / (s³ + (C/T) s² + (B/T²) s + A/T³)` by the bilinear transform (Tustin).

    ```text
    ẋ = F x + e₃ (A/T³) u,   F = ((0 1 0), (0 0 1), (−A/T³ −B/T² −C/T))
    x⁺ = (1 − hF/2)⁻¹ ((1 + hF/2) x + e₃ (h/2)(A/T³) (u + u⁺))
    ```

    The inverse is written out, since T = 5 ms gives entries of 1e6, for which elimination is inaccurate in float32.
    """
    half = 0.5 * time_step
    a, b, c = _A / smoothing_time**3, _B / smoothing_time**2, _C / smoothing_time
    one = jnp.ones_like(a * half)
    adjugate = jnp.array(
        [
            [one + half * (c + half * b), half * (1.0 + half * c), half * half],
            [-a * half * half, one + half * c, half],
            [-a * half, -half * (b + half * a), one],
        ]
    )
    inverse = adjugate / (1.0 + half * (c + half * (b + half * a)))
    return FilterGains(2.0 * inverse - jnp.eye(3, dtype=inverse.dtype), half * a * inverse[:, 2])


def filter_start(initial: Float[Array, "3"]) -> FilterState:
    """Return the state at rest at `initial`."""
    return FilterState(jnp.zeros((3, 3), initial.dtype).at[0].set(initial), initial)


def filter_update(gains: FilterGains, state: FilterState, value: Float[Array, "3"]) -> FilterState:
    """Process the input of this tick; the result holds the outputs of the same tick."""
    drive = gains.input_gain[:, None] * (state.previous_input + value)
    return FilterState(multiply(gains.transition, state.derivatives) + drive, value)


# --- generator ----------------------------------------------------------------------------------------------------


class SetpointParams(NamedTuple):
    """Speeds, limits and filters of the generator, discretised for a fixed tick."""

    speed: Float[Array, "2"]
    """Forward and vertical speed [m/s]."""
    attitude_rate: Float[Array, "2"]
    """Pitch and yaw rate [rad/s]."""
    nose_down_limits: Float[Array, "2"]
    """Limits of the nose-down angle [rad]."""
    turbo_boost: Float[Array, ""]
    turbo_rate: Float[Array, ""]
    """Rate of the turbo boost [1/s]."""
    attitude_gain: Float[Array, ""]
    """`K` of the attitude filter [1/s]."""
    descent_speed: Float[Array, ""]
    """Speed of a descent [m/s]."""
    deceleration: Float[Array, ""]
    """Deceleration to rest or to the descent speed [m/s²]."""
    position_lags: Float[Array, "2"]
    """Constants of the position filter: `T B / A` [s] and `T² C / A` [s²]."""
    position_filter: FilterGains
    jerk_filter: FilterGains
    angular_velocity_filter: FilterGains
    base_from_heading: Float[Array, "3 3"]
    """Columns forward, left, up."""
    time_step: Float[Array, ""]
    """Time step [s]."""


class RawSetpoint(NamedTuple):
    """Set-point before smoothing."""

    position: Float[Array, "3"]
    """Position of the centre of mass [m]."""
    velocity: Float[Array, "3"]
    """Velocity of the centre of mass [m/s]."""
    rpy: Float[Array, "3"]
    """Roll, pitch (nose down) and yaw of the heading frame [rad]."""
    turbo_ticks: Int[Array, ""]
    """Number of ticks of accumulated turbo."""


class SetpointState(NamedTuple):
    """State of the generator."""

    raw: RawSetpoint
    position: FilterState
    acceleration: FilterState
    """Filter of the acceleration, whose derivative is the jerk."""
    angular_velocity: FilterState
    rotation: Float[Array, "3 3"]
    """Smoothed attitude of the next tick."""


def setpoint_params(
    config: SetpointConfig, forward_axis: Float[Array, "3"], time_step: Float[Array, ""]
) -> SetpointParams:
    """Return the parameters for ticks of `time_step` [s] and a robot's forward axis in base axes."""
    forward_axis = jnp.asarray(forward_axis)
    up = jnp.array([0.0, 0.0, 1.0], forward_axis.dtype)
    smoothing = leaf(config.position_smoothing)
    return SetpointParams(
        speed=leaf(config.speed),
        attitude_rate=jnp.deg2rad(leaf(config.attitude_rate_deg)),
        nose_down_limits=jnp.deg2rad(leaf(config.nose_down_limits_deg)),
        turbo_boost=leaf(config.turbo_boost),
        turbo_rate=leaf(config.turbo_rate),
        attitude_gain=leaf(config.attitude_gain),
        descent_speed=leaf(config.descent_speed),
        deceleration=leaf(config.deceleration),
        position_lags=jnp.stack([smoothing * (_B / _A), smoothing**2 * (_C / _A)]),
        position_filter=filter_gains(smoothing, time_step),
        jerk_filter=filter_gains(leaf(config.acceleration_smoothing), time_step),
        angular_velocity_filter=filter_gains(leaf(config.angular_velocity_smoothing), time_step),
        base_from_heading=jnp.stack([forward_axis, cross(up, forward_axis), up], axis=1),
        time_step=time_step,
    )


def start(params: SetpointParams, com: Float[Array, "3"], rotation: Float[Array, "3 3"]) -> SetpointState:
    """Return the state at the centre of mass [m] and base rotation of the robot's first tick."""
    com, rotation = jnp.asarray(com), jnp.asarray(rotation)
    zero = jnp.zeros_like(com)
    rest = filter_start(zero)
    raw = RawSetpoint(com, zero, _heading_rpy(params, rotation), jnp.zeros((), jnp.int32))
    return SetpointState(raw, filter_start(com), rest, rest, rotation)


def _heading_rpy(params: SetpointParams, rotation: Array) -> Array:
    """Return roll, pitch and yaw (3,) of the heading frame for a base rotation [rad]."""
    return rpy_from_rotation(multiply(rotation, params.base_from_heading))


def update(
    params: SetpointParams, mission: Commands | Recording, state: SetpointState, time: Float[Array, ""]
) -> tuple[SetpointState, Setpoint]:
    """Return the set-point of the tick at `time` [s], from the autopilot's commands or from a recording.

    The smoothed attitude follows the raw one by `ω = −K sk(R_rawᵀ R)^∨`, integrated by forward Euler on the matrix;
    projection onto SO(3) at every tick removes the drift of that step.
    """
    if isinstance(mission, Recording):
        return _follow_recording(params, mission, state, time)
    return _smooth(params, state, _advance_raw(params, state.raw, autopilot_command(mission, time)))


def motion_of(setpoint: Setpoint) -> RecordedMotion:
    """Return the part of a set-point that a recording contains."""
    com = (setpoint.com_position, setpoint.com_velocity, setpoint.com_acceleration, setpoint.com_jerk)
    return RecordedMotion(jnp.stack([jnp.asarray(x) for x in com]), setpoint.rotation, setpoint.angular_velocity)


def follow(params: SetpointParams, state: SetpointState, motion: RecordedMotion) -> SetpointState:
    """Set the state to a given motion, from which a descent would begin."""
    com = motion.com
    # The filter input that keeps these outputs with zero jerk.
    ahead = com[0] + com[1] * params.position_lags[0] + com[2] * params.position_lags[1]
    velocity = com[1] + com[2] * params.position_lags[0]
    return SetpointState(
        raw=RawSetpoint(ahead, velocity, _heading_rpy(params, motion.rotation), jnp.zeros_like(state.raw.turbo_ticks)),
        position=FilterState(com[:3], ahead),
        acceleration=FilterState(jnp.stack([com[2], com[3], jnp.zeros_like(com[3])]), com[2]),
        angular_velocity=filter_update(params.angular_velocity_filter, state.angular_velocity, motion.angular_velocity),
        rotation=motion.rotation,
    )


def descend(params: SetpointParams, state: SetpointState) -> tuple[SetpointState, Setpoint]:
    """Return the set-point of a tick of the descent, which replaces the mission.

    The attitude becomes level, and the velocity approaches that of the descent (M115).
    """
    raw = state.raw
    step = params.attitude_rate[0] * params.time_step
    rpy = raw.rpy.at[:2].add(-jnp.clip(raw.rpy[:2], -step, step))
    change = jnp.zeros_like(raw.velocity).at[2].set(-params.descent_speed) - raw.velocity
    greatest, size = params.deceleration * params.time_step, safe_norm(change)
    velocity = raw.velocity + change * jnp.where(size > greatest, greatest / jnp.maximum(size, greatest), 1.0)
    position = raw.position + velocity * params.time_step
    return _smooth(params, state, RawSetpoint(position, velocity, rpy, jnp.zeros_like(raw.turbo_ticks)))


def without_place(setpoint: Setpoint, com: Float[Array, "3"]) -> Setpoint:
    """Return the set-point at the present centre of mass [m], for a robot that cannot hold its position (M107)."""
    zero = jnp.zeros_like(com)
    return setpoint._replace(com_position=com, com_acceleration=zero, com_jerk=zero)


def _smooth(params: SetpointParams, state: SetpointState, raw: RawSetpoint) -> tuple[SetpointState, Setpoint]:
    """Return the smoothed set-point of a raw one."""
    position = filter_update(params.position_filter, state.position, raw.position)
    acceleration = filter_update(params.jerk_filter, state.acceleration, position.derivatives[2])

    rotation = state.rotation
    raw_rotation = multiply(rotation_from_rpy(raw.rpy), params.base_from_heading.T)
    error = vee_of_skew_part(multiply(raw_rotation.T, rotation))
    omega = -params.attitude_gain * error
    angular = filter_update(params.angular_velocity_filter, state.angular_velocity, omega)
    turned = project_to_so3(rotation + multiply(rotation, skew(omega)) * params.time_step)

    setpoint = Setpoint(
        com_position=position.derivatives[0],
        com_velocity=position.derivatives[1],
        com_acceleration=position.derivatives[2],
        com_jerk=acceleration.derivatives[1],
        rotation=rotation,
        angular_velocity=angular.derivatives[0],
        angular_acceleration=angular.derivatives[1],
        angular_jerk=angular.derivatives[2],
    )
    return SetpointState(raw, position, acceleration, angular, turned), setpoint


def _follow_recording(
    params: SetpointParams, recording: Recording, state: SetpointState, time: Array
) -> tuple[SetpointState, Setpoint]:
    """Follow a recording unfiltered, except its angular velocity, filtered to obtain the missing derivatives."""
    motion = motion_at(recording, time)
    after = follow(params, state, motion)
    com, rates = motion.com, after.angular_velocity.derivatives
    return after, Setpoint(com[0], com[1], com[2], com[3], motion.rotation, rates[0], rates[1], rates[2])


def _advance_raw(params: SetpointParams, raw: RawSetpoint, command: AutopilotCommand) -> RawSetpoint:
    """Advance one tick of the published autopilot mapping, in flight.

    While turbo is commanded or not yet decayed, all other motions are ignored and the nose pitches down. The published
    boost is a floating-point sum that ends at a residue above zero, so one more step is taken; the counter reproduces
    it by moving as long as boost was left *before* the tick.
    """
    # Half a tick rounds up.
    full = jnp.floor(params.turbo_boost / (params.turbo_rate * params.time_step) + 0.5).astype(jnp.int32)
    in_turbo = command.turbo | (raw.turbo_ticks > 0)
    ticks = jnp.where(command.turbo, jnp.minimum(raw.turbo_ticks + 1, full), jnp.maximum(raw.turbo_ticks - 1, 0))
    forward = jnp.where(in_turbo, 1.0, command.forward)
    vertical = jnp.where(in_turbo, 0.0, command.vertical)
    nose_down = jnp.where(in_turbo, 1.0, command.nose_down)
    yaw_rate = jnp.where(in_turbo, 0.0, command.yaw)

    boost = ticks * (params.turbo_rate * params.time_step)
    roll, pitch, yaw = raw.rpy
    pitch = pitch + params.attitude_rate[0] * params.time_step * nose_down
    yaw = yaw + params.attitude_rate[1] * params.time_step * yaw_rate
    along = params.speed[0] * (1.0 + boost) * forward
    velocity = jnp.stack([jnp.cos(yaw) * along, jnp.sin(yaw) * along, params.speed[1] * vertical])
    pitch = jnp.clip(pitch, params.nose_down_limits[0], params.nose_down_limits[1])
    position = raw.position + velocity * params.time_step
    return RawSetpoint(position, velocity, jnp.stack([roll, pitch, yaw]), ticks)
