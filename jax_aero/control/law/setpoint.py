"""Smooth set-points of centre of mass and attitude, with derivatives, from autopilot commands.

Call `start` once, then `update` once per tick; the state is a pytree for `lax.scan`. All operations except the turbo
counter are floating-point, so set-points can be differentiated with respect to speeds, gains and smoothing times. The
raw attitude is that of the heading frame: forward, left, up, fixed to the base by the robot's forward axis.

Equations M43, M44, M47 and M48 of `docs/model`. Source: the published flight-control library.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero.base.arrays import namespace
from jax_aero.body.spatial import (
    exp_so3,
    multiply,
    project_to_so3,
    rotation_from_rpy,
    rpy_from_rotation,
    skew,
    vee_of_skew_part,
)
from jax_aero.config import SetpointConfig
from jax_aero.control.law.minimum_jerk import (
    FilterGains,
    FilterState,
    filter_gains,
    filter_lags,
    filter_start,
    filter_update,
)
from jax_aero.control.law.mission import AutopilotCommand, Mission, autopilot_command
from jax_aero.control.law.recorded import RecordedMotion, Recording, motion_at
from jax_aero.types import Array, Setpoint, leaf

DEGREE = np.pi / 180.0
"""[rad]."""
TURBO_BOOST, TURBO_RATE = 9.0, 2.0
"""Relative increase of the forward speed by the turbo command, and its growth [1/s]."""
POSITION_SMOOTHING, ACCELERATION_SMOOTHING, ANGULAR_VELOCITY_SMOOTHING = 1.5, 0.005, 0.05
"""Smoothing times [s]."""
ATTITUDE_GAIN = 1.0
"""`K` of the attitude filter [1/s]."""
LANDING_HEIGHT, LANDING_SPEED = 2.5, 0.2
"""Height above the ground [m] below which a landing descends slowly, and its greatest speed there [m/s]."""


class SetpointParams(NamedTuple):
    """Speeds, limits and filters of the generator, discretised for a fixed tick."""

    speed: Float[Array, "2"]
    """Forward and vertical speed [m/s]."""
    attitude_rate: Float[Array, "2"]
    """Pitch and yaw rate [rad/s]."""
    nose_down_limits: Float[Array, "2"]
    """Limits of the nose-down angle [rad]."""
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
    ground: Float[Array, ""]
    """Height of the centre of mass at touch-down [m]: that at the start."""


def setpoint_params(
    config: SetpointConfig, forward_axis: Float[Array, "3"], time_step: Float[Array, ""]
) -> SetpointParams:
    """Return the parameters for ticks of `time_step` [s] and a robot's forward axis in base axes."""
    smoothing = leaf(POSITION_SMOOTHING)
    xp, (x, y, _) = namespace(forward_axis), forward_axis
    return SetpointParams(
        speed=leaf(config.speed),
        attitude_rate=leaf(config.attitude_rate_deg) * DEGREE,
        nose_down_limits=leaf(config.nose_down_limits_deg) * DEGREE,
        position_lags=filter_lags(smoothing),
        position_filter=filter_gains(smoothing, time_step),
        jerk_filter=filter_gains(leaf(ACCELERATION_SMOOTHING), time_step),
        angular_velocity_filter=filter_gains(leaf(ANGULAR_VELOCITY_SMOOTHING), time_step),
        base_from_heading=xp.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]]),
        time_step=time_step,
    )


def start(params: SetpointParams, com: Float[Array, "3"], rotation: Float[Array, "3 3"]) -> SetpointState:
    """Return the state at the centre of mass [m] and base rotation of the robot's first tick."""
    com, rotation = jnp.asarray(com), jnp.asarray(rotation)
    zero = jnp.zeros_like(com)
    rest = filter_start(zero)
    raw = RawSetpoint(com, zero, _heading_rpy(params, rotation), jnp.zeros((), jnp.int32))
    return SetpointState(raw, filter_start(com), rest, rest, rotation, com[2])


def _heading_rpy(params: SetpointParams, rotation: Array) -> Array:
    """Return roll, pitch and yaw (3,) of the heading frame for a base rotation [rad]."""
    heading: Array = rpy_from_rotation(multiply(rotation, params.base_from_heading))
    return heading


def after(setpoint: Setpoint, time: float | Float[Array, ""]) -> Setpoint:
    """Return the set-point a short time [s] later, by its derivatives: the motion that it describes goes on (M151)."""
    half, sixth = time * time / 2.0, time * time * time / 6.0
    p, v, a, j = setpoint.com_position, setpoint.com_velocity, setpoint.com_acceleration, setpoint.com_jerk
    w, dw, ddw = setpoint.angular_velocity, setpoint.angular_acceleration, setpoint.angular_jerk
    return Setpoint(
        com_position=p + v * time + a * half + j * sixth,
        com_velocity=v + a * time + j * half,
        com_acceleration=a + j * time,
        com_jerk=j,
        rotation=multiply(setpoint.rotation, exp_so3(w * time + dw * half + ddw * sixth)),
        angular_velocity=w + dw * time + ddw * half,
        angular_acceleration=dw + ddw * time,
        angular_jerk=ddw,
    )


def update(
    params: SetpointParams, mission: Mission, state: SetpointState, time: Float[Array, ""]
) -> tuple[SetpointState, Setpoint]:
    """Return the set-point of the tick at `time` [s], from the autopilot's commands or a recording.

    The smoothed attitude follows the raw one by `ω = −K sk(R_rawᵀ R)^∨`, integrated by forward Euler on the matrix;
    projection onto SO(3) at every tick removes the drift of that step.
    """
    if isinstance(mission, Recording):
        return _follow_recording(params, mission, state, time)
    return _smooth(params, state, _advance_raw(params, state, autopilot_command(mission, time)))


def motion_of(setpoint: Setpoint) -> RecordedMotion:
    """Return the part of a set-point that a recording contains."""
    com = (setpoint.com_position, setpoint.com_velocity, setpoint.com_acceleration, setpoint.com_jerk)
    return RecordedMotion(jnp.stack([jnp.asarray(x) for x in com]), setpoint.rotation, setpoint.angular_velocity)


def follow(params: SetpointParams, state: SetpointState, motion: RecordedMotion) -> SetpointState:
    """Set the state to a given motion, from which the next set-points go on."""
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
        ground=state.ground,
    )


def move_on(params: SetpointParams, state: SetpointState) -> tuple[SetpointState, Setpoint]:
    """Return the set-point of the next tick after a given one, whose raw position moves on at constant velocity."""
    position = state.raw.position + state.raw.velocity * params.time_step
    return _smooth(params, state, state.raw._replace(position=position))


def _smooth(params: SetpointParams, state: SetpointState, raw: RawSetpoint) -> tuple[SetpointState, Setpoint]:
    """Return the smoothed set-point of a raw one."""
    position = filter_update(params.position_filter, state.position, raw.position)
    acceleration = filter_update(params.jerk_filter, state.acceleration, position.derivatives[2])

    rotation = state.rotation
    raw_rotation = multiply(rotation_from_rpy(raw.rpy), params.base_from_heading.T)
    error = vee_of_skew_part(multiply(raw_rotation.T, rotation))
    omega = -ATTITUDE_GAIN * error
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
    return SetpointState(raw, position, acceleration, angular, turned, state.ground), setpoint


def _follow_recording(
    params: SetpointParams, recording: Recording, state: SetpointState, time: Array
) -> tuple[SetpointState, Setpoint]:
    """Follow a recording unfiltered, except its angular velocity, filtered to obtain the missing derivatives."""
    motion = motion_at(recording, time)
    after = follow(params, state, motion)
    com, rates = motion.com, after.angular_velocity.derivatives
    return after, Setpoint(com[0], com[1], com[2], com[3], motion.rotation, rates[0], rates[1], rates[2])


def _advance_raw(params: SetpointParams, state: SetpointState, command: AutopilotCommand) -> RawSetpoint:
    """Advance one tick of the published autopilot mapping, in flight; a landing, near the ground slow, is ours.

    While turbo is commanded or not yet decayed, all other motions are ignored and the nose pitches down. The published
    boost is a floating-point sum that ends at a residue above zero, so one more step is taken; the counter reproduces
    it by moving as long as boost was left *before* the tick.
    """
    raw = state.raw
    # Half a tick rounds up.
    full = jnp.floor(TURBO_BOOST / (TURBO_RATE * params.time_step) + 0.5).astype(jnp.int32)
    in_turbo = command.turbo | (raw.turbo_ticks > 0)
    ticks = jnp.where(command.turbo, jnp.minimum(raw.turbo_ticks + 1, full), jnp.maximum(raw.turbo_ticks - 1, 0))
    forward = jnp.where(in_turbo, 1.0, command.forward)
    vertical = jnp.where(in_turbo, 0.0, command.vertical)
    nose_down = jnp.where(in_turbo, 1.0, command.nose_down)
    yaw_rate = jnp.where(in_turbo, 0.0, command.yaw)

    boost = ticks.astype(params.time_step.dtype) * (TURBO_RATE * params.time_step)
    roll, pitch, yaw = raw.rpy
    pitch = pitch + params.attitude_rate[0] * params.time_step * nose_down
    yaw = yaw + params.attitude_rate[1] * params.time_step * yaw_rate
    along = params.speed[0] * (1.0 + boost) * forward
    is_slow = command.lands & (raw.position[2] - state.ground < LANDING_HEIGHT)
    climb = jnp.where(is_slow, jnp.minimum(params.speed[1], LANDING_SPEED), params.speed[1]) * vertical
    velocity = jnp.stack([jnp.cos(yaw) * along, jnp.sin(yaw) * along, climb])
    pitch = jnp.clip(pitch, params.nose_down_limits[0], params.nose_down_limits[1])
    position = raw.position + velocity * params.time_step
    return RawSetpoint(position, velocity, jnp.stack([roll, pitch, yaw]), ticks)
