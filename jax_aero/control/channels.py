"""Measurements in which missing or implausible channels are replaced by predictions.

The model predicts every channel from its last value to this tick. A measured value is used if it is finite and within
its accepted range. Values of joints and base must also be near the prediction and must not be frozen, that is,
bit-identical for several ticks while the prediction moves away. Otherwise the prediction is used and the channel's age
grows.

All numbers of a measurement form one vector of `E` entries: wind, thrusts, joint positions, joint velocities, base
velocity, position and rotation (row by row). Each entry belongs to one of `C` channels.

Equations M101 to M103 of `docs/model.md`.
"""

from __future__ import annotations

import operator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from msgspec.structs import astuple

from jax_aero.config import ControllerSection, DivergenceConfig, Greatest, Jumps
from jax_aero.robot import RobotModel
from jax_aero.spatial import exp_so3, is_rotation, multiply, vee_of_skew_part
from jax_aero.types import Array, State, Static, join, leaf, pytree, where

GAP_MAX = 10.5
"""Longest time between two ticks, in time steps; half a time step allows for rounding."""

PAUSE_MAX = 1.0
"""Longest time without ticks that counts as a pause of the controller [s]; a longer one is a jump of the clock."""

TIME_MAX = 1e9
"""Longest flight [s]; beyond it, ticks of milliseconds are lost in the rounding of the time."""

VELOCITY, ROTATION = -3, -1
"""Indices of channels."""

FROZEN_SHARE = 0.02
"""Least distance between a frozen value and its prediction, as a share of `jump`; below it the value is at rest."""

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
}
"""Bits of a tick's modes, for what was not measured or how the robot flies without it, as in the Rust crate."""

WITHOUT_MOMENTUM = MODES["joints_predicted"] | MODES["rotation_predicted"] | MODES["velocity_predicted"]
"""Modes of a tick in which the momentum is not measured."""


@pytree
class ChannelLimits:
    """Criteria for accepting measurements, and constants of the predictions that replace them."""

    wind_hold: Float[Array, ""]
    """Time for which the last wind is held [s]."""
    wind_fade: Float[Array, ""]
    """Time in which the wind then fades to zero [s]."""
    frozen_ticks: Float[Array, ""]
    widening: Float[Array, ""]
    """Growth of the accepted distance with a channel's age, relative to `jump` [1/s]."""
    velocity_gain: Float[Array, ""]
    """Gain with which the base velocity follows the pose when it is not measured [1/s]."""
    descend_after: Float[Array, ""]
    """Age of a channel of joints or base after which the robot descends [s]."""
    greatest: Float[Array, " E"]
    jump: Float[Array, " E"]
    """Largest accepted distance from the prediction, in the unit of the entry; infinite if unlimited."""
    compares: Static[bool]
    """Whether values are compared with predictions."""
    needs_joint_velocity: Static[bool]
    """If false, joint velocities that are not measured count as zero, since a joint observer estimates them."""
    may_predict: Static[bool]
    """Whether values can be rejected, and so replaced by predictions, before the flight has diverged."""


class ChannelsState(NamedTuple):
    """State of the channels between two ticks."""

    age: Float[Array, " C"]
    """Time since each channel was last measured [s]."""
    same: Int[Array, " C"]
    """Number of consecutive ticks with unchanged bits."""
    is_frozen: Bool[Array, " C"]
    """Whether each channel is frozen; remains true until its bits change."""
    is_distrusted: Bool[Array, " C"]
    """Whether each channel is permanently rejected."""
    last: Float[Array, " E"]
    """The measurement of the last tick."""
    predicted: Float[Array, " E"]
    """Prediction of the present values from the last accepted ones."""
    acceleration: Float[Array, " N"]
    """Acceleration `ν̇` that the last command causes."""
    thrust_rate: Float[Array, " j"]
    """Thrust rates of the last command [N/s]."""
    time: Float[Array, ""]
    """Time of the last tick by the controller, M108 [s]."""
    clock_offset: Float[Array, ""]
    """Difference between the measurements' clock and the controller's time [s]."""
    is_begun: Bool[Array, ""]
    """Whether a tick has been processed."""
    is_descending: Bool[Array, ""]


class UsedMeasurement(NamedTuple):
    """A measurement without missing values, ready for use by a tick."""

    time: Float[Array, ""]
    """Time of the controller: that of the measurement, corrected for jumps of its clock [s]."""
    state: State
    thrust: Float[Array, " j"]
    wind: Float[Array, "3"]
    modes: Int[Array, ""]
    """Sum of the bits of `MODES`."""
    thrust_innovation: Float[Array, " j"]
    """Measured minus predicted thrust, or an estimator's correction of it; zero for thrusts that are not measured
    [N]."""
    elapsed: Float[Array, ""]
    """Time since the last tick [s]; one time step if unknown."""
    pause: Float[Array, ""]
    """Advance of the measurements' clock [s] if the time since the last tick is unknown, because either the clock has
    jumped or the controller has paused. Zero if that time is known or the advance is too long for a pause."""
    has_momentum: Bool[Array, ""]
    """Whether the momentum is computed from measurements and the time since the last tick is known."""


def channel_limits(controller: ControllerSection, robot: RobotModel, divergence: DivergenceConfig) -> ChannelLimits:
    """Return the limits of a configuration, entry by entry."""
    config, estimator = controller.channels, controller.estimator
    n, most = robot.n_joints, config.greatest
    # By default every value that a flight can reach before it counts as diverged is accepted.
    is_wild = any(map(operator.gt, astuple(divergence), astuple(DivergenceConfig())))
    free = dict.fromkeys(
        ("joint_position", "joint_velocity", "position", "rotation", "velocity", "angular_velocity"), np.inf
    )
    near = Jumps(**free) if config.jump is None else config.jump

    def entries(wind: float, thrust: Array, rotation: float, of: object) -> Array:
        sizes = {"joint_position": n, "joint_velocity": n, "velocity": 3, "angular_velocity": 3, "position": 3}
        values = [np.full(3, wind), np.asarray(thrust)]
        values += [np.full(size, getattr(of, name)) for name, size in sizes.items()]
        values += [np.full(9, rotation)]
        return leaf(np.concatenate(values))

    thrust_max = np.asarray(robot.jets.thrust_max)
    return ChannelLimits(
        wind_hold=leaf(config.wind_hold),
        wind_fade=leaf(config.wind_fade),
        frozen_ticks=leaf(config.frozen_ticks),
        widening=leaf(config.widening),
        velocity_gain=leaf(config.velocity_gain),
        descend_after=leaf(config.descend_after),
        greatest=entries(most.wind, leaf(most.thrust * thrust_max), 2.0, most),
        jump=entries(np.inf, leaf(np.full(thrust_max.shape, np.inf)), near.rotation, near),
        compares=config.jump is not None,
        needs_joint_velocity=estimator is None or estimator.joint_observer is None,
        may_predict=config.jump is not None or most != Greatest() or is_wild,
    )


def start(robot: RobotModel, state: State) -> ChannelsState:
    """Return the state before the first tick, whose measurement is accepted without comparison."""
    like = state.joint_position
    jets, n = robot.jets.thrust_max.shape[0], robot.n_joints
    owners = _owners(jets, n)
    channels = owners.shape[0]
    none = jnp.zeros(jets, like.dtype)
    numbers = _flatten(state, none, jnp.zeros(3, like.dtype))
    return ChannelsState(
        age=jnp.zeros(channels, like.dtype),
        same=jnp.zeros(channels, jnp.int32),
        is_frozen=jnp.zeros(channels, bool),
        is_distrusted=jnp.zeros(channels, bool),
        last=numbers,
        predicted=numbers,
        acceleration=jnp.zeros(6 + n, like.dtype),
        thrust_rate=none,
        time=jnp.zeros((), like.dtype),
        clock_offset=jnp.zeros((), like.dtype),
        is_begun=jnp.array(False),
        is_descending=jnp.array(False),
    )


def update(
    limits: ChannelLimits,
    memory: ChannelsState,
    time_step: Float[Array, ""],
    time: Float[Array, ""],
    state: State,
    thrust: Float[Array, " j"],
    wind: Float[Array, "3"],
) -> tuple[ChannelsState, UsedMeasurement]:
    """Process a measurement at `time` [s] by its clock: return the channels' state and the usable measurement."""
    if not limits.needs_joint_velocity:
        joints = state.velocity[6:]
        state = state._replace(velocity=state.velocity.at[6:].set(jnp.where(jnp.isfinite(joints), joints, 0.0)))
    jets, n = thrust.shape[0], state.joint_position.shape[0]
    owners = _owners(jets, n)
    owner = owners.argmax(axis=0)
    now = _flatten(state, thrust, wind)

    is_known = (time >= 0.0) & (time <= TIME_MAX)
    following = memory.time + time_step
    measured = jnp.where(is_known, time - memory.clock_offset, following)
    elapsed = measured - memory.time
    is_step = (elapsed > 0.0) & (elapsed < GAP_MAX * time_step)
    dt = jnp.where(is_step, elapsed, time_step)
    may_have_paused = memory.is_begun & ~is_step & (elapsed > 0.0) & (elapsed <= PAUSE_MAX)
    pause = jnp.where(may_have_paused, elapsed, 0.0)
    has_jumped = memory.is_begun & ~is_step & limits.compares
    now_time = jnp.where(has_jumped, following, measured)
    clock_offset = jnp.where(has_jumped, time - following, memory.clock_offset)
    modes = jnp.where(is_known & ~has_jumped, 0, MODES["clock_predicted"])

    def all_entries(entries: Array) -> Array:
        return jnp.all(entries[None, :] | ~owners, axis=1)

    is_plausible = all_entries(jnp.abs(now) <= limits.greatest) & ~memory.is_distrusted
    is_plausible = is_plausible.at[ROTATION].set(is_plausible[ROTATION] & is_rotation(state.base_rotation))
    # The first measurement is what it is compared with.
    is_first = (~memory.is_begun & is_plausible)[owner]
    memory = memory._replace(predicted=jnp.where(is_first, now, memory.predicted))
    predicted = jnp.where(memory.is_begun, _predict(limits, memory, jets, n, dt), memory.predicted)

    is_same = memory.is_begun & all_entries(now == memory.last)
    same = jnp.where(is_same, memory.same + 1, 0)

    def judge(predicted: Array) -> tuple[Array, Array]:
        """Return whether each channel is accepted as measured, and whether it is frozen."""
        if not limits.compares:
            return is_plausible, memory.is_frozen
        distance = jnp.abs(now - predicted)
        # A change during a pause does not count as a jump.
        gate = 1.0 + limits.widening * memory.age + pause / time_step
        is_near = all_entries(distance <= gate[owner] * limits.jump)
        leaves = (same >= limits.frozen_ticks) & ~all_entries(distance <= FROZEN_SHARE * limits.jump)
        is_frozen = is_same & (memory.is_frozen | leaves)
        return is_plausible & is_near & ~is_frozen, is_frozen

    # The pose is integrated with the velocity of this tick, measured or predicted.
    velocity = jnp.where(judge(predicted)[0][VELOCITY], now[-18:-12], predicted[-18:-12])
    pose = _integrate(predicted[-12:], velocity, dt)
    pose = pose.at[:3].set(jnp.clip(pose[:3], -limits.greatest[-12:-9], limits.greatest[-12:-9]))
    predicted = jnp.where(memory.is_begun, predicted.at[-12:].set(pose), memory.predicted)
    is_measured, is_frozen = judge(predicted)
    age = jnp.where(is_measured, 0.0, memory.age + dt)
    of_entry = is_measured[owner]
    # Rejected values, which may be NaN, must enter neither values nor derivatives.
    now = jnp.where(of_entry, now, predicted)
    # An innovation over an unknown time has no meaning.
    innovation = jnp.where(memory.is_begun & is_step, (now - predicted)[3 : 3 + jets], 0.0)
    # For joints and base with unchanged bits the prediction continues, so that frozen values can be detected.
    is_vital = np.arange(owners.shape[0]) > jets
    predicted = jnp.where((is_measured & ~(is_same & is_vital))[owner], now, predicted)

    # Differences between poses that were newly measured at both this tick and the last.
    is_new = is_measured & ~is_same & (memory.same == 0) & (memory.age == 0.0)
    fresh = memory.is_begun & is_step & jnp.all(is_new[-2:])
    before = jnp.where(of_entry & jnp.isfinite(memory.last), memory.last, now)
    moved = now[-12:-9] - before[-12:-9]
    turned = vee_of_skew_part(multiply(now[-9:].reshape(3, 3), before[-9:].reshape(3, 3).T))
    share = -jnp.expm1(-limits.velocity_gain * dt)
    lost = predicted[-18:-12]
    followed = lost + share * (jnp.concatenate([moved, turned]) / dt - lost)
    predicted = predicted.at[-18:-12].set(jnp.where(fresh & ~is_measured[VELOCITY], followed, lost))

    used = jnp.where(of_entry, now, predicted)
    left = 1.0 - (age[0] - limits.wind_hold) / limits.wind_fade
    fading = jnp.where(is_measured[0], 1.0, jnp.clip(left, 0.0, 1.0))
    used = used.at[:3].multiply(fading)
    is_descending = memory.is_descending | jnp.any(age[1 + jets :] > limits.descend_after)
    bits = np.array([1] + [4] * jets + [8, 64, 16, 32])
    for bit in np.unique(bits):
        modes += jnp.where(jnp.any(~is_measured[bits == bit]), int(bit), 0)
    modes += jnp.where(~is_measured[0] & (left <= 0.0), MODES["wind_lost"], 0)
    modes += jnp.where(is_descending, MODES["descending"], 0)

    has_momentum = (is_step | ~memory.is_begun) & ((modes & WITHOUT_MOMENTUM) == 0)
    after = memory._replace(
        time=now_time,
        clock_offset=clock_offset,
        age=age,
        same=same,
        is_frozen=is_frozen,
        last=_flatten(state, thrust, wind),
        predicted=predicted,
        is_begun=jnp.array(True),
        is_descending=is_descending,
    )
    seen, thrusts = _parts(used, jets, n)
    modes = modes.astype(jnp.int32)
    return after, UsedMeasurement(now_time, seen, thrusts, used[:3], modes, innovation, dt, pause, has_momentum)


def select_accepted(memory: ChannelsState, used: UsedMeasurement) -> tuple[State, Float[Array, " j"]]:
    """Return the state and thrusts of the last measurement for an estimator, with NaN for rejected values.

    A rejected base velocity is replaced by the one that follows the pose.
    """
    jets, n = used.thrust.shape[0], used.state.joint_position.shape[0]
    is_accepted = (memory.age == 0.0).at[VELOCITY].set(True)[_owners(jets, n).argmax(axis=0)]
    return _parts(jnp.where(is_accepted, _flatten(used.state, used.thrust, used.wind), jnp.nan), jets, n)


def replace(limits: ChannelLimits, state: State, thrust: Float[Array, " j"], used: UsedMeasurement) -> UsedMeasurement:
    """Replace the measurement by an estimate, unless the estimate has values outside the accepted range."""
    is_plausible = jnp.all(jnp.abs(_flatten(state, thrust, used.wind)) <= limits.greatest)
    return where(is_plausible, used._replace(state=state, thrust=thrust), used)


def reject_sensor(memory: ChannelsState, is_wrong: Bool[Array, " j"], deviation: Float[Array, " j"]) -> ChannelsState:
    """Permanently reject the thrust sensors of some jets, whose measurements were too large by `deviation` [N]."""
    jets = is_wrong.shape[0]
    return memory._replace(
        is_distrusted=memory.is_distrusted.at[1 : 1 + jets].set(memory.is_distrusted[1 : 1 + jets] | is_wrong),
        predicted=memory.predicted.at[3 : 3 + jets].add(jnp.where(is_wrong, -deviation, 0.0)),
    )


def _owners(jets: int, n: int) -> np.ndarray:
    """Return the mask (C, E) of the entries that belong to each channel."""
    sizes = [3, *[1] * jets, 2 * n, 6, 3, 9]
    return np.repeat(np.eye(len(sizes), dtype=bool), sizes, axis=1)


def _flatten(state: State, thrust: Array, wind: Array) -> Array:
    joints = (state.joint_position, state.velocity[6:])
    base = (state.velocity[:6], state.base_position, state.base_rotation.reshape(9))
    return jnp.concatenate([wind, thrust, *joints, *base])


def _parts(numbers: Array, jets: int, n: int) -> tuple[State, Array]:
    """Return state and thrusts from the vector of entries, the inverse of `_flatten`."""
    joints = numbers[3 + jets : 3 + jets + 2 * n]
    state = State(
        base_position=numbers[-12:-9],
        base_rotation=numbers[-9:].reshape(3, 3),
        joint_position=joints[:n],
        velocity=join(numbers[-18:-12], joints[n:]),
    )
    return state, numbers[3 : 3 + jets]


def _predict(limits: ChannelLimits, memory: ChannelsState, jets: int, n: int, dt: Array) -> Array:
    """Predict every value except the pose after `dt` [s]: M78 for velocities and joints, M31 for thrusts.

    The prediction is limited to the accepted range.
    """
    last = memory.predicted
    thrust = jnp.maximum(last[3 : 3 + jets] + dt * memory.thrust_rate, 0.0)
    rates = last[3 + jets + n : 3 + jets + 2 * n] + dt * memory.acceleration[6:]
    joints = last[3 + jets : 3 + jets + n] + dt * rates
    velocity = last[-18:-12] + dt * memory.acceleration[:6]
    moved = jnp.concatenate([last[:3], thrust, joints, rates, velocity, last[-12:]])
    return jnp.clip(moved, -limits.greatest, limits.greatest)


def _integrate(pose: Array, velocity: Array, dt: Array) -> Array:
    """Integrate position and rotation (12,) over `dt` [s] with the base velocity (6,): M78."""
    rotation = multiply(exp_so3(dt * velocity[3:]), pose[3:].reshape(3, 3))
    return jnp.concatenate([pose[:3] + dt * velocity[:3], rotation.reshape(9)])
