"""The guard of a controller: the channels of the measurement, and the stages that are configured.

```text
                measure                       judge                                  predict
channels        missing values predicted                                             acceleration (M101)
wind_observer   its wind, for the measured                                           the next wind
observer                                      unmodelled wrench of the momentum
engines                                       limits of thrusts, wrong sensors
joints          length of their ways          which do not follow their torques      commanded displacements
latency         measured joints and thrusts   whether commands are late
supervisor                                    whether the flight strays
estimator       its state, for the measured   without what wrong sensors measured    stores the command
```
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from jax_aero.aero import AeroModel
from jax_aero.control.command import Command
from jax_aero.control.guard import channels, engines, estimator, joints, latency, observer, supervisor, wind_observer
from jax_aero.control.guard.channels import ChannelLimits
from jax_aero.control.guard.engines import EngineLimits
from jax_aero.control.guard.estimator import Estimator, Order
from jax_aero.control.guard.joints import TRIED_VELOCITY, JointLimits
from jax_aero.control.guard.latency import LatencyMonitor
from jax_aero.control.guard.observer import ObserverGains
from jax_aero.control.guard.supervisor import SupervisorLimits
from jax_aero.control.guard.wind_observer import WindObserver
from jax_aero.control.law.limits import Limits
from jax_aero.control.measurement import Measurement, Reading, UsedMeasurement
from jax_aero.control.modes import MODES
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model, Terms
from jax_aero.dynamics import accelerate
from jax_aero.robot import RobotModel
from jax_aero.spatial import cross
from jax_aero.types import Array, Setpoint, State, where


class Measured(NamedTuple):
    """What stages improve before the model is computed."""

    memory: ControllerState
    estimates: Measurement
    """The measurement after the estimators."""
    wind_std: Float[Array, "3"]
    """Standard deviation of the wind in `estimates` [m/s]."""
    used: UsedMeasurement


class Judged(NamedTuple):
    """What stages compare after the model has been computed."""

    memory: ControllerState
    used: UsedMeasurement
    model: Model
    setpoint: Setpoint
    """What the law follows."""
    limits: Limits
    """What the law may use."""
    is_wrong: Bool[Array, " j"]
    """Which thrust sensors are found to be wrong in this tick."""
    deviation: Float[Array, " j"]
    """Deviations of the thrusts from their commands, the errors of wrong sensors [N]."""


class Stage:
    """An optional part of the guard.

    A tick calls it in three places; where a stage has no function, it does nothing.
    """

    def start(self, memory: ControllerState, _state: State) -> ControllerState:
        """Set the stage's own part of the state of a controller that starts in this state."""
        return memory

    def measure(self, tick: Measured) -> Measured:
        """Improve the measurement, before the model is computed."""
        return tick

    def judge(self, tick: Judged) -> Judged:
        """Compare the model with the measurement."""
        return tick

    def predict(self, memory: ControllerState, _terms: Terms, _command: Command) -> ControllerState:
        """Store what the command lets expect in the next tick."""
        return memory


@dataclass(frozen=True)
class Guard:
    """Channels and stages of one controller, in the order in which a tick calls them."""

    channels: ChannelLimits
    stages: tuple[Stage, ...]
    robot: RobotModel
    time_step: Float[Array, ""]

    def start(self, memory: ControllerState, state: State) -> ControllerState:
        """Set the stages' parts of the state of a controller that starts in `state`."""
        for stage in self.stages:
            memory = stage.start(memory, state)
        return memory

    def measure(self, memory: ControllerState, measurement: Measurement) -> Measured:
        """Process a measurement, with the wind estimated in the last tick where there is an estimate."""
        wind_std = jnp.zeros_like(measurement.wind)
        if memory.wind is not None:
            measurement, wind_std = measurement._replace(wind=memory.wind.wind), memory.wind.std
        known, used = channels.update(self.channels, memory.channels, self.time_step, *measurement[:4])
        tick = Measured(memory._replace(channels=known), measurement, wind_std, used)
        for stage in self.stages:
            tick = stage.measure(tick)
        return tick

    def judge(
        self, memory: ControllerState, used: UsedMeasurement, model: Model, setpoint: Setpoint, limits: Limits
    ) -> Judged:
        """Compare the model of this tick with its measurement."""
        none = jnp.zeros_like(used.thrust)
        tick = Judged(memory, used, model, setpoint, limits, is_wrong=none > 0.0, deviation=none)
        for stage in self.stages:
            tick = stage.judge(tick)
        return tick

    def predict(self, memory: ControllerState, terms: Terms, model: Model, command: Command) -> ControllerState:
        """Store what the command lets expect in the next tick.

        The channels continue with the acceleration under the command (M101), with the observed wrench on the base.
        """
        kin, wrench = model.kinematics, model.momentum.unmodelled_wrench
        moment = wrench[3:] + cross(kin.com - terms.measurement.state.base_position, wrench[:3])
        acting = jnp.concatenate([wrench[:3], moment, terms.limits.torque_share * command.joint_torque])
        acceleration = model.free_acceleration + accelerate(model.inverse_mass, acting)
        known = memory.channels._replace(acceleration=acceleration, thrust_rate=command.thrust_rate)
        memory = memory._replace(channels=known)
        for stage in self.stages:
            memory = stage.predict(memory, terms, command)
        return memory

    def change_torques(
        self, memory: ControllerState, terms: Terms, torque: Float[Array, " n"], share: Float[Array, ""]
    ) -> ControllerState:
        """Correct what was predicted: these torques act for a share of the tick in place of the last ones [N m]."""
        between, known, acts = memory.between, memory.channels, terms.limits.torque_share
        assert between is not None
        more = torque - between.torque
        change, mean = accelerate(terms.inverse_mass, jnp.pad(acts * more, (6, 0))), between.mean_torque + share * more
        memory = memory._replace(
            channels=known._replace(acceleration=known.acceleration + share * change),
            between=between._replace(torque=torque, acceleration=between.acceleration + change[6:], mean_torque=mean),
        )
        if memory.estimator is None:
            return memory
        corrected = estimator.replace_command(memory.estimator, acts * mean, known.thrust_rate)
        return memory._replace(estimator=corrected)


@dataclass(frozen=True)
class WindStage(Stage):
    """The wind observer."""

    settings: WindObserver
    robot: RobotModel
    aero: AeroModel

    def start(self, memory: ControllerState, _state: State) -> ControllerState:
        """Begin with still air."""
        return memory._replace(wind=wind_observer.start(self.settings))

    def predict(self, memory: ControllerState, terms: Terms, _command: Command) -> ControllerState:
        """Estimate the wind of the next tick."""
        assert memory.wind is not None
        used, momentum, a_t = terms.measurement, terms.dynamics.momentum, terms.momentum.a_t
        wind = wind_observer.update(
            self.settings, self.robot, self.aero, memory.wind, used, terms.kinematics, momentum, a_t
        )
        return memory._replace(wind=wind)


@dataclass(frozen=True)
class ObserverStage(Stage):
    """The observer of the unmodelled wrench."""

    gains: ObserverGains

    def start(self, memory: ControllerState, _state: State) -> ControllerState:
        """Begin with no wrench."""
        return memory._replace(observer=observer.start(memory.posture))

    def judge(self, tick: Judged) -> Judged:
        """Add the observed wrench to the momentum rate."""
        last, used, (_, dyn, *_, momentum, _) = tick.memory.observer, tick.used, tick.model
        assert last is not None
        compared = observer.update(self.gains, used.elapsed, last, dyn.momentum, momentum.rate_estimate)
        observed = where(used.has_momentum, compared, observer.hold(last))
        model = tick.model._replace(momentum=momentum.add_unmodelled(observed.wrench))
        return tick._replace(memory=tick.memory._replace(observer=observed), model=model)


@dataclass(frozen=True)
class EngineStage(Stage):
    """The monitors of the engines."""

    settings: EngineLimits
    robot: RobotModel
    momentum_shares: Float[Array, "2"]
    """Shares of a change of force and moment that the estimated momentum follows per tick, 1 if it is measured."""

    def start(self, memory: ControllerState, _state: State) -> ControllerState:
        """Begin with engines that reach every thrust."""
        like = jnp.zeros(self.robot.jets.count, memory.posture.dtype)
        return memory._replace(engines=engines.start(like))

    def judge(self, tick: Judged) -> Judged:
        """Find limited and lost engines, and wrong thrust sensors."""
        memory, used, momentum = tick.memory, tick.used, tick.model.momentum
        assert memory.engines is not None
        residual = jnp.zeros_like(momentum.rate_estimate) if memory.observer is None else memory.observer.residual
        turning, is_wrong, deviation = engines.update(
            self.settings,
            memory.engines,
            used.elapsed,
            used.thrust,
            used.thrust_innovation,
            memory.channels.thrust_rate,
            (used.modes & MODES["thrust_modelled"]) == 0,
            momentum.a_t,
            residual,
            used.has_momentum,
            self.momentum_shares,
        )
        known = channels.reject_sensor(memory.channels, is_wrong, deviation)
        limits, is_lost = engines.limit(self.settings, turning, tick.limits)
        known = known._replace(is_descending=known.is_descending | is_lost)
        modes = used.modes | jnp.where(jnp.any(turning.is_limited), MODES["engine_limited"], 0)
        return tick._replace(
            memory=memory._replace(channels=known, engines=turning),
            used=used._replace(modes=modes),
            limits=limits,
            is_wrong=is_wrong,
            deviation=deviation,
        )


@dataclass(frozen=True)
class JointStage(Stage):
    """The detection of joints that do not follow their torques."""

    settings: JointLimits
    robot: RobotModel
    time_step: Float[Array, ""]
    observer: ObserverGains | None
    """Of the same guard."""

    def start(self, memory: ControllerState, state: State) -> ControllerState:
        """Begin with joints that follow."""
        return memory._replace(joints=joints.start(jnp.asarray(state.joint_position)))

    def measure(self, tick: Measured) -> Measured:
        """Add to the ways of the joints."""
        last, used = tick.memory.joints, tick.used
        assert last is not None
        position = used.state.joint_position
        is_new = (used.modes & MODES["begun_again"]) != 0
        last = where(is_new, joints.begin_again(last, position), last)
        is_measured = (used.modes & MODES["joints_predicted"]) == 0
        return tick._replace(
            memory=tick.memory._replace(joints=joints.measure(last, position, is_measured, used.elapsed))
        )

    def judge(self, tick: Judged) -> Judged:
        """Find joints that are stuck, weak or free, and bound what the law demands of them."""
        memory, used, gain = tick.memory, tick.used, tick.model.inverse_mass.joint_gain
        last = memory.joints
        assert last is not None
        if memory.between is not None:
            last = last._replace(torque=memory.between.mean_torque)
        moved = (used.state.velocity[6:] - last.velocity) / used.elapsed
        judged = joints.judge(
            self.settings,
            last,
            used.elapsed,
            moved - memory.channels.acceleration[6:],
            gain,
            jnp.asarray(self.robot.joint_stops),
        )
        is_doubted = memory.engines is not None and jnp.any(memory.engines.is_doubted)
        if memory.observer is not None and self.observer is not None:
            moment_max = joints.PUSH_SHARE * self.observer.moment_max
            is_doubted |= jnp.linalg.norm(memory.observer.residual[3:]) > moment_max
        found = where(used.has_momentum & ~jnp.asarray(is_doubted), judged, joints.hold(last))
        is_free = found.share == 0.0
        usual = tick.limits.joint_velocity
        fastest = jnp.where(found.is_stuck, jnp.minimum(usual, TRIED_VELOCITY), jnp.where(is_free, 0.0, usual))
        limits = tick.limits._replace(joint_velocity=fastest, torque_share=found.share, is_stuck=found.is_stuck)
        # These follow no velocity.
        integral = jnp.where(found.is_stuck | is_free, 0.0, memory.velocity_error_integral)
        modes = used.modes | jnp.where(jnp.any(found.is_limited), MODES["joint_limited"], 0)
        memory = memory._replace(joints=found, velocity_error_integral=integral)
        return tick._replace(memory=memory, used=used._replace(modes=modes), limits=limits)

    def predict(self, memory: ControllerState, terms: Terms, command: Command) -> ControllerState:
        """Add the commanded displacements, and store what the next tick is compared with."""
        last, velocity = memory.joints, command.joint_velocity
        assert last is not None
        assert velocity is not None
        return memory._replace(
            joints=last._replace(
                commanded=last.commanded + self.time_step * velocity,
                velocity=terms.measurement.state.velocity[6:],
                torque=command.joint_torque,
            )
        )


@dataclass(frozen=True)
class LatencyStage(Stage):
    """The measurement of latencies."""

    settings: LatencyMonitor
    robot: RobotModel

    def start(self, memory: ControllerState, state: State) -> ControllerState:
        """Begin with nothing measured."""
        position = jnp.asarray(state.joint_position)
        jets = jnp.zeros(self.robot.jets.count, position.dtype)
        return memory._replace(latency=latency.start(self.settings, position, jets))

    def measure(self, tick: Measured) -> Measured:
        """Take in positions of joints and thrusts."""
        last, used = tick.memory.latency, tick.used
        assert last is not None

        def is_accepted(mode: str) -> Bool[Array, ""]:
            return (used.modes & (MODES[mode] | MODES["begun_again"])) == 0

        are_measured = is_accepted("joints_predicted"), is_accepted("thrust_modelled")
        position, thrust = used.state.joint_position, used.thrust
        taken = latency.measure(self.settings, last, position, thrust, are_measured, used.elapsed)
        return tick._replace(memory=tick.memory._replace(latency=taken))

    def judge(self, tick: Judged) -> Judged:
        """Compare them with commands of different ages."""
        memory, used, limits, gain = tick.memory, tick.used, tick.limits, tick.model.inverse_mass.joint_gain
        last, known = memory.latency, memory.channels
        assert last is not None
        torque = last.torque if memory.between is None else memory.between.mean_torque
        by_torque = gain @ (limits.torque_share * torque)
        is_comparable = used.has_momentum & ~jnp.any(limits.is_stuck)
        compared, is_late = latency.compare(
            self.settings, last, known.acceleration[6:], by_torque, known.thrust_rate, is_comparable, used.elapsed
        )
        modes = used.modes | jnp.where(is_late, MODES["late"], 0)
        return tick._replace(memory=memory._replace(latency=compared), used=used._replace(modes=modes))

    def predict(self, memory: ControllerState, _terms: Terms, command: Command) -> ControllerState:
        """Store the torques."""
        assert memory.latency is not None
        return memory._replace(latency=memory.latency._replace(torque=command.joint_torque))


@dataclass(frozen=True)
class SupervisorStage(Stage):
    """The supervisor."""

    settings: SupervisorLimits

    def start(self, memory: ControllerState, _state: State) -> ControllerState:
        """Begin with a flight that follows its set-point."""
        return memory._replace(exceeded=jnp.zeros((), memory.posture.dtype))

    def judge(self, tick: Judged) -> Judged:
        """Find out whether the flight strays."""
        memory, used, (kin, dyn, *_), limits = tick.memory, tick.used, tick.model, self.settings
        assert memory.exceeded is not None
        com_velocity = dyn.momentum[:3] / dyn.mass_matrix[0, 0]
        exceeded, strays = supervisor.update(
            limits, memory.exceeded, used.elapsed, used.state, kin.com, com_velocity, tick.setpoint
        )
        known = memory.channels
        known = known._replace(is_descending=known.is_descending | (strays & (limits.descend > 0.0)))
        modes = used.modes | jnp.where(strays, MODES["straying"], 0)
        memory = memory._replace(channels=known, exceeded=exceeded)
        return tick._replace(memory=memory, used=used._replace(modes=modes))


@dataclass(frozen=True)
class EstimatorStage(Stage):
    """The state estimator."""

    settings: Estimator
    robot: RobotModel
    aero: AeroModel
    channels: ChannelLimits

    def start(self, memory: ControllerState, state: State) -> ControllerState:
        """Begin with the first measurement."""
        return memory._replace(estimator=estimator.start(self.settings, state, self.robot.jets.count))

    def measure(self, tick: Measured) -> Measured:
        """Replace the measurement by the estimate, where that is plausible."""
        memory, estimates, _, used = tick
        assert memory.estimator is not None
        accepted = Reading(*channels.select_accepted(memory.channels, used))
        is_new = (used.pause > 0.0) | ((used.modes & MODES["begun_again"]) != 0)
        before = estimator.restart(memory.estimator, is_new)
        estimating, estimate, innovation = estimator.update(
            self.settings, self.robot, self.aero, before, accepted, used.elapsed
        )
        used = channels.replace(self.channels, *estimate, used)._replace(thrust_innovation=innovation)
        return tick._replace(
            memory=memory._replace(estimator=estimating),
            estimates=estimates._replace(state=used.state, thrust=used.thrust),
            used=used,
        )

    def judge(self, tick: Judged) -> Judged:
        """Forget what wrong sensors have measured."""
        memory = tick.memory
        assert memory.estimator is not None
        right = estimator.correct_thrusts(memory.estimator, tick.is_wrong, tick.deviation)
        return tick._replace(memory=memory._replace(estimator=right))

    def predict(self, memory: ControllerState, terms: Terms, command: Command) -> ControllerState:
        """Store the inputs that act until the next tick."""
        assert memory.estimator is not None
        unmodelled, wind = terms.momentum.unmodelled_wrench, terms.measurement.wind
        torque = terms.limits.torque_share * command.joint_torque
        order = Order(torque, command.thrust_rate, unmodelled, wind, self.settings.time_step)
        return memory._replace(estimator=estimator.command(memory.estimator, order))
