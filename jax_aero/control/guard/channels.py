"""Measurements in which missing or implausible channels are replaced by predictions.

The model predicts every channel from its last value to this tick. A measured value is used if it is finite and within
its accepted range. Values of wind, joints and base must also be near the prediction, and those of joints and base must
not be frozen, that is, bit-identical for several ticks while the prediction moves away. Otherwise the prediction is
used and the channel's age grows. The first measurements of a flight may be the wrong ones: where more of the following
ones contradict the prediction, and agree with each other, than it rests on, the flight begins again from them.

All numbers of a measurement form one vector of `E` entries, see `Layout`. Each entry belongs to one of `C` channels.

Equations M101 to M103 and M141 of `docs/model`.
"""

from __future__ import annotations

import itertools
import operator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from msgspec.structs import astuple

from jax_aero.config import ControllerSection, DivergenceConfig, Greatest, Jumps
from jax_aero.control.measurement import UsedMeasurement
from jax_aero.control.modes import MODES, WITHOUT_MOMENTUM
from jax_aero.jets import predict_thrust
from jax_aero.robot import RobotModel
from jax_aero.spatial import exp_so3, is_rotation, multiply, vee_of_skew_part
from jax_aero.types import Array, State, Static, join, leaf, pytree, where

GAP_MAX = 10.5
"""Longest time between two ticks, in time steps; half a time step allows for rounding."""

PAUSE_MAX = 1.0
"""Longest time without ticks that counts as a pause of the controller [s]; a longer one is a jump of the clock."""

TIME_MAX = 1e9
"""Longest flight [s]; beyond it, ticks of milliseconds are lost in the rounding of the time."""

FROZEN_SHARE = 0.02
"""Least distance between a frozen value and its prediction, as a share of `jump`; below it the value is at rest."""


class Channel(NamedTuple):
    """Entries that are accepted or predicted together."""

    entries: slice
    mode: int
    """Bit of a tick without it."""
    is_vital: bool
    """Whether the robot descends if it is missing."""


class Layout:
    """Places of a measurement's numbers in one vector, and of the channels, for `jets` jets and `n` joints.

    The rotation is stored row by row.
    """

    def __init__(self, jets: int, n: int) -> None:
        ends = [int(end) for end in np.cumsum([0, 3, jets, n, n, 6, 3, 9])]
        parts = [slice(start, end) for start, end in itertools.pairwise(ends)]
        self.wind, self.thrust, self.joint_position, self.joint_velocity, *base = parts
        self.velocity, self.position, self.rotation = base
        self.joints = slice(self.joint_position.start, self.joint_velocity.stop)
        self.pose = slice(self.position.start, self.rotation.stop)
        thrusts = [slice(place, place + 1) for place in range(self.thrust.start, self.thrust.stop)]
        self.channels = [
            Channel(self.wind, MODES["wind_held"], is_vital=False),
            *(Channel(thrust, MODES["thrust_modelled"], is_vital=False) for thrust in thrusts),
            Channel(self.joints, MODES["joints_predicted"], is_vital=True),
            Channel(self.velocity, MODES["velocity_predicted"], is_vital=True),
            Channel(self.position, MODES["position_predicted"], is_vital=True),
            Channel(self.rotation, MODES["rotation_predicted"], is_vital=True),
        ]
        self.is_vital = np.array([channel.is_vital for channel in self.channels])
        owned = np.zeros((len(self.channels), ends[-1]), dtype=bool)
        for channel, entries in zip(self.channels, owned, strict=True):
            entries[channel.entries] = True
        self.owned = owned
        """Mask (C, E) of the entries that belong to each channel."""
        self.owner = owned.argmax(axis=0)
        """Channel (E,) to which each entry belongs."""

    def place(self, entries: slice) -> int:
        """Return the index of the channel with these entries."""
        return int(self.owner[entries.start])

    def flatten(self, state: State, thrust: Float[Array, " j"], wind: Float[Array, "3"]) -> Float[Array, " E"]:
        """Return the numbers of a measurement."""
        joints = (state.joint_position, state.velocity[6:])
        base = (state.velocity[:6], state.base_position, state.base_rotation.reshape(9))
        return jnp.concatenate([wind, thrust, *joints, *base])

    def parts(self, numbers: Float[Array, " E"]) -> tuple[State, Float[Array, " j"]]:
        """Return state and thrusts of the numbers of a measurement."""
        state = State(
            base_position=numbers[self.position],
            base_rotation=numbers[self.rotation].reshape(3, 3),
            joint_position=numbers[self.joint_position],
            velocity=join(numbers[self.velocity], numbers[self.joint_velocity]),
        )
        return state, numbers[self.thrust]

    @classmethod
    def of(cls, state: State, thrust: Float[Array, " j"]) -> Layout:
        """Return the layout of measurements of these sizes."""
        return cls(thrust.shape[0], state.joint_position.shape[0])


@pytree
class ChannelLimits:
    """Criteria for accepting measurements, and constants of the predictions that replace them."""

    wind_hold: Float[Array, ""]
    """Time for which the last wind is held [s]."""
    wind_fade: Float[Array, ""]
    """Time in which the wind then fades to zero [s]."""
    frozen_ticks: Float[Array, ""]
    confirmation: Float[Array, ""]
    """Share of `jump` within which the second measurement confirms the first."""
    widening: Float[Array, ""]
    """Growth of the accepted distance with a channel's age, relative to `jump` [1/s]."""
    velocity_gain: Float[Array, ""]
    """Gain with which the base velocity follows the pose when it is not measured [1/s]."""
    descend_after: Float[Array, ""]
    """Age of a channel of joints or base after which the robot descends [s]."""
    thrust_min: Float[Array, " j"]
    """Least thrusts of engines that run [N]."""
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
    support: Int[Array, " C"]
    """Number of measurements that each prediction rests on: those accepted since the flight began, or began again."""
    against: Int[Array, " C"]
    """Number of consecutive measurements that contradict the prediction, but not each other."""
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


def channel_limits(controller: ControllerSection, robot: RobotModel, divergence: DivergenceConfig) -> ChannelLimits:
    """Return the limits of a configuration, entry by entry."""
    config, estimator = controller.channels, controller.estimator
    n, most = robot.n_joints, config.greatest
    # By default every value that a flight can reach before it counts as diverged is accepted.
    is_wild = any(map(operator.gt, astuple(divergence), astuple(DivergenceConfig())))
    free = dict.fromkeys(
        ("wind", "joint_position", "joint_velocity", "position", "rotation", "velocity", "angular_velocity"), np.inf
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
        confirmation=leaf(config.confirmation),
        widening=leaf(config.widening),
        velocity_gain=leaf(config.velocity_gain),
        descend_after=leaf(config.descend_after),
        thrust_min=leaf(np.asarray(robot.jets.thrust_min)),
        greatest=entries(most.wind, leaf(most.thrust * thrust_max), 2.0, most),
        jump=entries(near.wind, leaf(np.full(thrust_max.shape, np.inf)), near.rotation, near),
        compares=config.jump is not None,
        needs_joint_velocity=estimator is None or estimator.joint_observer is None,
        may_predict=config.jump is not None or most != Greatest() or is_wild,
    )


def start(robot: RobotModel, state: State) -> ChannelsState:
    """Return the state before the first tick, whose measurement is accepted without comparison."""
    like = state.joint_position
    jets, n = robot.jets.thrust_max.shape[0], robot.n_joints
    layout, none = Layout(jets, n), jnp.zeros(jets, like.dtype)
    channels = len(layout.channels)
    numbers = layout.flatten(state, none, jnp.zeros(3, like.dtype))
    return ChannelsState(
        age=jnp.zeros(channels, like.dtype),
        same=jnp.zeros(channels, jnp.int32),
        support=jnp.zeros(channels, jnp.int32),
        against=jnp.zeros(channels, jnp.int32),
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


class _Clock(NamedTuple):
    """Time of a tick (M108)."""

    time: Float[Array, ""]
    """By the controller [s]."""
    offset: Float[Array, ""]
    """Difference between the measurements' clock and it [s]."""
    is_step: Bool[Array, ""]
    """Whether the time since the last tick is known."""
    elapsed: Float[Array, ""]
    """That time; one time step if it is unknown [s]."""
    pause: Float[Array, ""]
    """As in `UsedMeasurement` [s]."""
    is_predicted: Bool[Array, ""]
    """Whether the clock of the measurements is missing or has jumped."""


def _clock(limits: ChannelLimits, memory: ChannelsState, time_step: Array, time: Array) -> _Clock:
    """Advance the time with that of a measurement [s]."""
    is_known = (time >= 0.0) & (time <= TIME_MAX)
    following = memory.time + time_step
    measured = jnp.where(is_known, time - memory.clock_offset, following)
    elapsed = measured - memory.time
    is_step = (elapsed > 0.0) & (elapsed < GAP_MAX * time_step)
    may_have_paused = memory.is_begun & ~is_step & (elapsed > 0.0) & (elapsed <= PAUSE_MAX)
    has_jumped = memory.is_begun & ~is_step & limits.compares
    return _Clock(
        time=jnp.where(has_jumped, following, measured),
        offset=jnp.where(has_jumped, time - following, memory.clock_offset),
        is_step=is_step,
        elapsed=jnp.where(is_step, elapsed, time_step),
        pause=jnp.where(may_have_paused, elapsed, 0.0),
        is_predicted=~is_known | has_jumped,
    )


class _Verdict(NamedTuple):
    """Judgement of every channel."""

    is_measured: Bool[Array, " C"]
    """Whether it is accepted as measured."""
    is_frozen: Bool[Array, " C"]
    is_distrusted: Bool[Array, " C"]
    is_same: Bool[Array, " C"]
    """Whether its bits are those of the last tick."""
    same: Int[Array, " C"]
    """Number of consecutive ticks with unchanged bits."""
    support: Int[Array, " C"]
    against: Int[Array, " C"]
    is_outvoted: Bool[Array, " C"]
    """Whether more measurements contradict the prediction than it rests on."""


def _judge(
    limits: ChannelLimits, layout: Layout, memory: ChannelsState, now: Array, predicted: Array, missed_ticks: Array
) -> _Verdict:
    """Compare the numbers of a measurement (E,) with their ranges and with predictions."""

    def all_entries(entries: Array) -> Array:
        return jnp.all(entries[None, :] | ~layout.owned, axis=1)

    is_same = memory.is_begun & all_entries(now == memory.last)
    same = jnp.where(is_same, memory.same + 1, 0)
    is_plausible = all_entries(jnp.abs(now) <= limits.greatest)
    rotation = layout.place(layout.rotation)
    is_turned = is_plausible[rotation] & is_rotation(now[layout.rotation].reshape(3, 3))
    is_plausible = is_plausible.at[rotation].set(is_turned)
    if not limits.compares:
        never = jnp.zeros_like(is_plausible)
        is_accepted = is_plausible & ~memory.is_distrusted
        return _Verdict(
            is_accepted, memory.is_frozen, memory.is_distrusted, is_same, same, memory.support, memory.against, never
        )
    distance = jnp.abs(now - predicted)
    # A change during a pause does not count as a jump.
    width = jnp.where(memory.support > 1, 1.0, limits.confirmation)
    gate = width + limits.widening * memory.age + missed_ticks
    # The first measurement is what it is compared with.
    is_near = all_entries(distance <= gate[layout.owner] * limits.jump) | ~memory.is_begun
    # Of joints and base the same bits are no other measurement.
    counts = ~is_same | ~layout.is_vital
    agrees = (memory.against > 0) & all_entries(jnp.abs(now - memory.last) <= limits.jump)
    run = jnp.where(is_plausible & ~is_near, 1 + jnp.where(agrees, memory.against, 0), 0)
    against = jnp.where(counts, run, memory.against)
    # The prediction of a wind does not move.
    has_lasted = same.astype(distance.dtype) >= limits.frozen_ticks
    leaves = has_lasted & ~all_entries(distance <= FROZEN_SHARE * limits.jump) & layout.is_vital
    is_frozen = is_same & (memory.is_frozen | leaves)
    is_doubted = is_plausible & ~is_near & (memory.age > limits.wind_hold)
    wind = np.arange(len(layout.channels)) == layout.place(layout.wind)
    is_distrusted = memory.is_distrusted | is_doubted & wind
    is_outvoted = (against > memory.support) & ~is_frozen & ~is_distrusted
    is_accepted = is_plausible & is_near & ~is_frozen & ~is_distrusted | is_outvoted
    support = jnp.where(is_outvoted, against, memory.support + (is_accepted & counts).astype(jnp.int32))
    against = jnp.where(is_outvoted, 0, against)
    return _Verdict(is_accepted, is_frozen, is_distrusted, is_same, same, support, against, is_outvoted)


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
    layout = Layout.of(state, thrust)
    of_wind, of_velocity = layout.place(layout.wind), layout.place(layout.velocity)
    measured, clock = layout.flatten(state, thrust, wind), _clock(limits, memory, time_step, time)
    dt, missed_ticks = clock.elapsed, clock.pause / time_step

    predicted = jnp.where(memory.is_begun, _predict(limits, layout, memory, dt), memory.predicted)
    # The pose is integrated with the velocity of this tick, measured or predicted.
    has_velocity = _judge(limits, layout, memory, measured, predicted, missed_ticks).is_measured[of_velocity]
    velocity = jnp.where(has_velocity, measured[layout.velocity], predicted[layout.velocity])
    pose = _integrate(predicted[layout.pose], velocity, dt)
    range_of_position = limits.greatest[layout.position]
    pose = pose.at[:3].set(jnp.clip(pose[:3], -range_of_position, range_of_position))
    predicted = jnp.where(memory.is_begun, predicted.at[layout.pose].set(pose), memory.predicted)

    verdict = _judge(limits, layout, memory, measured, predicted, missed_ticks)
    is_measured, is_same = verdict.is_measured, verdict.is_same
    age = jnp.where(is_measured, 0.0, memory.age + dt)
    of_entry = is_measured[layout.owner]
    # Rejected values, which may be NaN, must enter neither values nor derivatives.
    now = jnp.where(of_entry, measured, predicted)
    # An innovation over an unknown time has no meaning.
    innovation = jnp.where(memory.is_begun & clock.is_step, (now - predicted)[layout.thrust], 0.0)
    # For joints and base with unchanged bits the prediction continues, so that frozen values can be detected.
    continues = is_same & layout.is_vital
    predicted = jnp.where((is_measured & ~continues)[layout.owner], now, predicted)

    # Differences between poses that were newly measured at both this tick and the last.
    is_new = is_measured & ~is_same & (memory.same == 0) & (memory.age == 0.0)
    is_pose_new = is_new[layout.place(layout.position)] & is_new[layout.place(layout.rotation)]
    follows = memory.is_begun & clock.is_step & is_pose_new & ~is_measured[of_velocity]
    before = jnp.where(of_entry & jnp.isfinite(memory.last), memory.last, now)
    lost = predicted[layout.velocity]
    followed = _follow_pose(limits, layout, lost, before, now, dt)
    predicted = predicted.at[layout.velocity].set(jnp.where(follows, followed, lost))

    used = jnp.where(of_entry, now, predicted)
    left = 1.0 - (age[of_wind] - limits.wind_hold) / limits.wind_fade
    used = used.at[layout.wind].multiply(jnp.where(is_measured[of_wind], 1.0, jnp.clip(left, 0.0, 1.0)))
    is_descending = memory.is_descending | jnp.any(layout.is_vital & (age > limits.descend_after))
    modes = jnp.where(clock.is_predicted, MODES["clock_predicted"], 0)
    of_channels = np.array([channel.mode for channel in layout.channels])
    for mode in np.unique(of_channels):
        modes += jnp.where(jnp.any(~is_measured[of_channels == mode]), int(mode), 0)
    modes += jnp.where(~is_measured[of_wind] & (left <= 0.0), MODES["wind_lost"], 0)
    modes += jnp.where(is_descending, MODES["descending"], 0)
    modes += jnp.where(jnp.any(verdict.is_outvoted & layout.is_vital), MODES["begun_again"], 0)

    after = memory._replace(
        time=clock.time,
        clock_offset=clock.offset,
        age=age,
        same=verdict.same,
        support=verdict.support,
        against=verdict.against,
        is_frozen=verdict.is_frozen,
        is_distrusted=verdict.is_distrusted,
        last=measured,
        predicted=predicted,
        is_begun=jnp.array(True),
        is_descending=is_descending,
    )
    seen, thrusts = layout.parts(used)
    return after, UsedMeasurement(
        time=clock.time,
        state=seen,
        thrust=thrusts,
        wind=used[layout.wind],
        modes=modes.astype(jnp.int32),
        thrust_innovation=innovation,
        elapsed=dt,
        pause=clock.pause,
        has_momentum=(clock.is_step | ~memory.is_begun) & ((modes & WITHOUT_MOMENTUM) == 0),
    )


def select_accepted(memory: ChannelsState, used: UsedMeasurement) -> tuple[State, Float[Array, " j"]]:
    """Return the state and thrusts of the last measurement for an estimator, with NaN for rejected values.

    A rejected base velocity is replaced by the one that follows the pose.
    """
    layout = Layout.of(used.state, used.thrust)
    is_accepted = (memory.age == 0.0).at[layout.place(layout.velocity)].set(True)[layout.owner]
    return layout.parts(jnp.where(is_accepted, layout.flatten(used.state, used.thrust, used.wind), jnp.nan))


def replace(limits: ChannelLimits, state: State, thrust: Float[Array, " j"], used: UsedMeasurement) -> UsedMeasurement:
    """Replace the measurement by an estimate, unless the estimate has values outside the accepted range."""
    numbers = Layout.of(state, thrust).flatten(state, thrust, used.wind)
    is_plausible = jnp.all(jnp.abs(numbers) <= limits.greatest)
    return where(is_plausible, used._replace(state=state, thrust=thrust), used)


def reject_sensor(memory: ChannelsState, is_wrong: Bool[Array, " j"], deviation: Float[Array, " j"]) -> ChannelsState:
    """Permanently reject the thrust sensors of some jets, whose measurements were too large by `deviation` [N]."""
    layout = Layout(is_wrong.shape[0], memory.acceleration.shape[0] - 6)
    is_distrusted = jnp.zeros_like(memory.predicted, bool).at[layout.thrust].set(is_wrong)
    return memory._replace(
        is_distrusted=memory.is_distrusted | jnp.any(is_distrusted[None] & layout.owned, axis=1),
        predicted=memory.predicted.at[layout.thrust].add(jnp.where(is_wrong, -deviation, 0.0)),
    )


def _predict(limits: ChannelLimits, layout: Layout, memory: ChannelsState, dt: Array) -> Array:
    """Predict every value except the pose after `dt` [s]: M78 for velocities and joints, M31 for thrusts.

    The prediction is limited to the accepted range.
    """
    last, acceleration = memory.predicted, memory.acceleration
    rates = last[layout.joint_velocity] + dt * acceleration[6:]
    thrust = predict_thrust(last[layout.thrust], memory.thrust_rate, dt, limits.thrust_min)
    moved = last.at[layout.thrust].set(thrust)
    moved = moved.at[layout.joint_velocity].set(rates)
    moved = moved.at[layout.joint_position].add(dt * rates)
    moved = moved.at[layout.velocity].add(dt * acceleration[:6])
    return jnp.clip(moved, -limits.greatest, limits.greatest)


def _follow_pose(limits: ChannelLimits, layout: Layout, velocity: Array, before: Array, now: Array, dt: Array) -> Array:
    """Let a base velocity (6,) follow the difference of two poses, `dt` [s] apart."""
    moved = now[layout.position] - before[layout.position]
    after, first = (numbers[layout.rotation].reshape(3, 3) for numbers in (now, before))
    turned = vee_of_skew_part(multiply(after, first.T))
    share = -jnp.expm1(-limits.velocity_gain * dt)
    return velocity + share * (jnp.concatenate([moved, turned]) / dt - velocity)


def _integrate(pose: Array, velocity: Array, dt: Array) -> Array:
    """Integrate position and rotation (12,) over `dt` [s] with the base velocity (6,): M78."""
    rotation = multiply(exp_so3(dt * velocity[3:]), pose[3:].reshape(3, 3))
    return jnp.concatenate([pose[:3] + dt * velocity[:3], rotation.reshape(9)])
