"""The flight controller: one tick, from a measurement to thrust rates and joint torques.

`tick` follows the order of the controller: measure, model, guard, law, torques, predict. It is a pure function of one
sample; use `vmap`, `jit`, `grad` and `scan` on it.

>>> params = momentum_controller(config, robot)
>>> memory = init(params, robot, state)
>>> memory, command, terms = tick(params, robot, memory, time, state, thrust, wind)

The unknowns of the momentum QP are `u = (Ṫ, ṡ)`, thrust rates and joint velocities.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jax_aero.aero import AeroModel, LinkConventions, ReadNetwork, aero_model, weight_forces
from jax_aero.aero.network_card import load_network
from jax_aero.config import RateFeedback, ScenarioConfig
from jax_aero.control import qp
from jax_aero.control.command import BOTH_HELD, MOMENTUM_HELD, TORQUE_HELD, Command
from jax_aero.control.guard import channels, engines, estimator, latency, observer
from jax_aero.control.guard.channels import ChannelLimits
from jax_aero.control.guard.engines import EngineLimits
from jax_aero.control.guard.estimator import Estimator
from jax_aero.control.guard.joints import JointLimits
from jax_aero.control.guard.latency import LatencyMonitor
from jax_aero.control.guard.observer import ObserverGains
from jax_aero.control.guard.stages import (
    EngineStage,
    EstimatorStage,
    Guard,
    JointStage,
    LatencyStage,
    ObserverStage,
    SupervisorStage,
    WindStage,
)
from jax_aero.control.guard.supervisor import SupervisorLimits
from jax_aero.control.guard.wind_observer import WindObserver
from jax_aero.control.law import between as joints_between
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.attitude import MomentumGains
from jax_aero.control.law.between import JointMeasurement, JointsBetween, JointTracker, joint_tracker
from jax_aero.control.law.limits import Limits
from jax_aero.control.law.mission import Mission, load_mission
from jax_aero.control.law.momentum_qp import Task
from jax_aero.control.law.mpc.config import Mpc, mpc_params
from jax_aero.control.law.mpc.law import PredictiveLaw
from jax_aero.control.law.policy_card import load_policy
from jax_aero.control.law.rates import Law, MomentumLaw, Rates
from jax_aero.control.law.residual import Residual, steer
from jax_aero.control.law.setpoint import SetpointParams
from jax_aero.control.law.tasks import TaskParams, choose_limits, symmetric_pairs, task_params
from jax_aero.control.law.torque import TorqueParams
from jax_aero.control.law.torques import Torque, Torques
from jax_aero.control.measurement import Measurement, UsedMeasurement
from jax_aero.control.modes import MODES
from jax_aero.control.preview import Preview
from jax_aero.control.state import ControllerState
from jax_aero.control.terms import Model, Terms, update_model
from jax_aero.dynamics import accelerate, dynamics
from jax_aero.kinematics import kinematics
from jax_aero.robot import RobotModel
from jax_aero.spatial import multiply
from jax_aero.types import Array, Dynamics, Kinematics, Setpoint, State, Static, leaf, leaves, pytree, where


class Switches(NamedTuple):
    """Options that change the structure of the computation; hashable, fixed at compilation."""

    conventions: LinkConventions
    """Points at which link forces act."""
    lambda_a: bool
    """Whether `Λ_a` enters the derivative of the momentum rate."""
    torque: bool
    """Whether `J_aᵀ f_a` enters the torque law."""
    symmetric_pairs: tuple[tuple[int, int], ...]
    """Jets that should have equal thrust rates."""
    latency: float
    """Time until torques act [s]."""
    lead: int
    """Whole ticks of that."""


@pytree
class MomentumController:
    """The flight controller, a `Controller`: every number is a leaf, the switches are structure."""

    switches: Static[Switches]
    aero: AeroModel
    """The controller's aerodynamic model."""
    rate_feedback: Float[Array, "6"]
    """1 or 0: which components of the total estimated wrench enter the momentum rate."""
    momentum: MomentumGains
    tasks: TaskParams
    other_tasks: tuple[Task, ...]
    """User-defined objectives of the momentum QP."""
    torque: TorqueParams
    torque_max: Float[Array, " n"]
    """Greatest joint torques [N m]."""
    torque_rate_max: Float[Array, " n"]
    """Greatest torque rates [N m/s]."""
    setpoint: SetpointParams
    channels: ChannelLimits
    estimator: Estimator | None
    """State estimator that replaces the measured state; `None` without one."""
    wind_observer: WindObserver | None
    """Observer whose wind replaces the measured one; `None` without one."""
    observer: ObserverGains | None
    engines: EngineLimits | None
    joints: JointLimits | None
    """Detection of faulty joints; `None` without it."""
    latency_monitor: LatencyMonitor | None
    """Measurement of latencies; `None` without it."""
    supervisor: SupervisorLimits | None
    mpc: Mpc | None
    """The predictive law; `None` where the momentum QP decides."""
    between: JointTracker | None
    """Joints between two ticks of the law; `None` if each computes the torques once."""
    mission: Mission
    time_step: Float[Array, ""]
    """[s]."""
    residual: Residual | None = None
    """What is added to the answer of the law; `None` for nothing."""

    def guard(self, robot: RobotModel) -> Guard:
        """Return the channels and the stages that are configured."""
        winds, observes, monitors, estimates = self.wind_observer, self.observer, self.engines, self.estimator
        shares = jnp.ones_like(self.time_step, shape=2) if estimates is None else estimates.momentum_shares
        stages = (
            None if winds is None else WindStage(winds, robot, self.aero),
            None if observes is None else ObserverStage(observes),
            None if monitors is None else EngineStage(monitors, robot, shares),
            None if self.joints is None else JointStage(self.joints, robot, self.time_step, observes),
            None if self.latency_monitor is None else LatencyStage(self.latency_monitor, robot),
            None if self.supervisor is None else SupervisorStage(self.supervisor),
            None if estimates is None else EstimatorStage(estimates, robot, self.aero, self.channels),
        )
        return Guard(self.channels, tuple(stage for stage in stages if stage is not None), robot, self.time_step)

    def limits(self, robot: RobotModel) -> Limits:
        """Return what the law may use while the guard finds nothing."""
        thrusts = jnp.asarray(robot.jets.thrust_min), jnp.asarray(robot.jets.thrust_max)
        fast = self.tasks.joint_velocity_max, self.torque_rate_max
        whole = jnp.ones_like(self.torque_rate_max)
        return Limits(self.momentum, jnp.array(True), *thrusts, *fast, whole, whole < 0.0)

    def law(self) -> Law:
        """Return the law, from the set-point to thrust rates and joint velocities."""
        pairs = self.switches.symmetric_pairs
        momentum = MomentumLaw(self.setpoint, self.mission, self.tasks, pairs, self.other_tasks, *self.switches[-2:])
        if self.mpc is None:
            return momentum
        gains = self.torque.kd, self.torque.kp
        return PredictiveLaw(self.mpc, momentum, self.aero, self.switches.conventions, gains, self.time_step)

    def torques(self) -> Torques:
        """Return the torque law."""
        period = self.time_step if self.between is None else self.between.period
        return Torques(self.torque, self.torque_max, period)

    def model(self, robot: RobotModel, used: UsedMeasurement) -> Model:
        """Return the values of a tick that depend on the measurement only."""
        conventions, lambda_a, torque = self.switches[:3]
        return update_model(robot, self.aero, conventions, self.rate_feedback, lambda_a, torque, used)

    def init(self, robot: RobotModel, state: State) -> ControllerState:
        """Return the state of the controller at the first tick; see `init`."""
        return init(self, robot, state)

    def step(
        self, robot: RobotModel, memory: ControllerState, measurement: Measurement
    ) -> tuple[ControllerState, Command]:
        """Compute one tick on the configured mission; see `tick`."""
        memory, command, terms = tick(self, robot, memory, *measurement[:4], preview=measurement.preview)
        return memory, command._replace(setpoint=terms.setpoint, terms=terms)

    def step_torques(
        self,
        robot: RobotModel,
        memory: ControllerState,
        command: Command,
        measured: JointMeasurement,
        tick: Int[Array, ""],
    ) -> tuple[ControllerState, Float[Array, " n"]]:
        """Compute one tick of the torques; see `tick_torques`."""
        assert command.terms is not None
        return tick_torques(self, robot, memory, command, command.terms, measured, tick)


def momentum_controller(
    config: ScenarioConfig,
    robot: RobotModel,
    read_network: ReadNetwork = load_network,
    tasks: tuple[Task, ...] = (),
) -> MomentumController:
    """Return the controller of a robot as configured. Call it outside loops, since it computes interpolation tables.

    `robot` is the controller's model of the robot; `tasks` are user-defined objectives, added to the controller's own.

    Raises
    ------
    ValueError
        If the configuration does not fit the robot; the message names the key.
    """
    controller, time_step = config.controller, leaf(config.simulator.time_step)
    if controller.contact is not None or not controller.use_jets:
        key, value = ("contact", "given") if controller.contact is not None else ("use_jets", "false")
        raise ValueError(f"`controller.{key}` is {value}; expected a controller that flies: JAX has no feet")
    is_of_one_rate = controller.torque.steps == 1
    feedback, aero = controller.aero_feedback, aero_model(controller.aero, robot, read_network)
    estimates, winds = controller.estimator, controller.wind_observer
    return MomentumController(
        switches=Switches(
            LinkConventions(controller.lever_arm, controller.jacobian_offset, controller.link_velocity),
            lambda_a=feedback.lambda_,
            torque=feedback.torque,
            symmetric_pairs=symmetric_pairs(controller, robot),
            latency=0.0 if estimates is None else estimates.latency.torque,
            lead=0 if estimates is None else estimator.latency_in_ticks(estimates.latency, float(time_step))[0],
        ),
        aero=weight_forces(aero, config.disturbances.aero_estimate, robot, "disturbances.aero_estimate"),
        rate_feedback=_components(feedback.momentum_rate),
        momentum=leaves(MomentumGains, controller.momentum),
        tasks=task_params(controller, robot, config.simulator.time_step),
        other_tasks=tasks,
        torque=leaves(TorqueParams, controller.torque),
        torque_max=choose_limits(robot.joint_torque_max, controller.torque.torque_max, robot),
        torque_rate_max=choose_limits(robot.joint_torque_rate_max, controller.torque.torque_rate_max, robot),
        setpoint=generator.setpoint_params(controller.setpoint, robot.forward_axis, time_step),
        channels=channels.channel_limits(controller, robot, config.simulator.divergence),
        estimator=None if estimates is None else estimator.estimator(estimates, time_step),
        wind_observer=None if winds is None else leaves(WindObserver, winds),
        observer=None if controller.observer is None else leaves(ObserverGains, controller.observer),
        engines=None if controller.engines is None else engines.engine_limits(controller.engines, robot),
        joints=leaves(JointLimits, controller.joints) if controller.joints is not None and robot.n_joints else None,
        latency_monitor=None
        if controller.latency_monitor is None or not robot.n_joints
        else latency.latency_monitor(
            controller.latency_monitor, estimates, controller.torque.steps, config.simulator.time_step
        ),
        supervisor=None if controller.supervisor is None else leaves(SupervisorLimits, controller.supervisor),
        mpc=None if controller.mpc is None else mpc_params(controller.mpc, robot, config.simulator.time_step),
        between=None if is_of_one_rate else joint_tracker(controller, config.simulator.time_step),
        mission=load_mission(config.mission),
        time_step=time_step,
        residual=None if controller.policy is None else load_policy(controller.policy.card, robot),
    )


def _components(known: RateFeedback) -> Array:
    """Return 1 for each known component (6,) of a wrench, 0 for the others."""
    has_force, has_moment = known in ("wrench", "force"), known in ("wrench", "moment")
    return leaf(np.repeat([has_force, has_moment], 3))


def init(params: MomentumController, robot: RobotModel, state: State) -> ControllerState:
    """Return the controller's state at the first tick, whose position, attitude and posture become the set-point."""
    kin = kinematics(robot, state)
    n, jets = robot.n_joints, params.tasks.thrust_rate.shape[0]
    zeros = jnp.zeros_like(state.joint_position)
    memory = ControllerState(
        **_reference(params, state, kin, dynamics(robot, state, kin)),
        channels=channels.start(robot, state),
        joint_torque=zeros,
        momentum_start=qp.cold_start(jets + n, zeros.dtype),
        torque_start=qp.cold_start(n, zeros.dtype),
        plan=params.law().plan(jets, zeros.dtype),
        between=None if params.between is None else JointsBetween(zeros, zeros, zeros, zeros, zeros, jnp.array(False)),
        residual=None if params.residual is None else observer.start(zeros),
    )
    return params.guard(robot).start(memory, state)


def _reference(params: MomentumController, state: State, kin: Kinematics, dyn: Dynamics) -> dict[str, Any]:
    """Return the part of the controller's state that refers to the measurement with which a flight begins."""
    rotation = state.base_rotation
    return {
        "setpoint": generator.start(params.setpoint, kin.com, rotation),
        "posture": jnp.asarray(state.joint_position),
        "inertia_0": multiply(multiply(rotation.T, dyn.centroidal_inertia), rotation),
        "velocity_error_integral": jnp.zeros_like(state.joint_position),
        "torque_is_known": jnp.array(False),
    }


def _begin_again(
    params: MomentumController, memory: ControllerState, used: UsedMeasurement, model: Model
) -> ControllerState:
    """Take the measurement of this tick for the reference of the flight, if it begins again (M141)."""
    if not params.channels.compares:
        return memory
    is_new = (used.modes & MODES["begun_again"]) != 0
    again = memory._replace(**_reference(params, used.state, model.kinematics, model.dynamics))
    return where(is_new, again, memory)


def tick(
    params: MomentumController,
    robot: RobotModel,
    memory: ControllerState,
    time: Float[Array, ""],
    state: State,
    thrust: Float[Array, " j"],
    wind: Float[Array, "3"],
    setpoint: Setpoint | None = None,
    preview: Preview | None = None,
) -> tuple[ControllerState, Command, Terms]:
    """Compute one tick; return the next state, the command, and every intermediate value.

    `time` [s], `thrust` [N], `wind` [m/s, inertial axes]. A given `setpoint` replaces the mission; during a descent
    neither is followed. `preview` is what is known of the future.

    The estimator, if configured, uses the accepted part of state and thrusts; the wind observer, if configured,
    replaces the measured wind by its estimate from the previous ticks. Missing or implausible parts of the measurement
    are predicted; the command's `degraded_modes` names them.
    """
    guard, law, torques = params.guard(robot), params.law(), params.torques()
    with jax.default_matmul_precision("highest"):
        memory, estimates, wind_std, used = guard.measure(memory, Measurement(time, state, thrust, wind))
        model = params.model(robot, used)
        memory = _begin_again(params, memory, used, model)
        known = Preview() if preview is None else preview
        memory, followed = law.follow(memory, used, setpoint, known)
        memory, used, model, _, limits, _, _ = guard.judge(memory, used, model, followed.due, params.limits(robot))
        memory, rates = law.solve(robot, memory, used, model, limits, followed)
        added = None
        if params.residual is not None:
            due = generator.without_place(followed.due, model.kinematics.com)
            due = where(limits.holds_position, followed.due, due)
            memory, used, rates, added = steer(params.residual, robot, memory, used, model, due, rates)
        memory, torque = torques.solve(memory, used, model, limits, rates)
        command = _command(used, rates, torque)
        terms = Terms(
            estimates,
            used,
            wind_std,
            used.state if params.channels.may_predict else estimates.state,
            *model[:5],
            rates.setpoint,
            rates.attitude,
            rates.momentum_qp,
            torque.torque_qp,
            torque.unlimited_torque,
            limits,
            jnp.full(2, jnp.nan, time.dtype) if memory.latency is None else memory.latency.measured,
            added,
        )
        memory = guard.predict(memory, terms, model, command)
        if params.between is not None:
            now, acting = used.state, command.joint_torque
            faster = memory.channels.acceleration[6:]
            begun = JointsBetween(now.joint_position, now.velocity[6:], acting, faster, acting, torque.are_solved)
            memory = memory._replace(between=begun)
        return memory, command, terms


def tick_torques(
    params: MomentumController,
    robot: RobotModel,
    memory: ControllerState,
    command: Command,
    terms: Terms,
    measured: JointMeasurement,
    tick: Int[Array, ""],
) -> tuple[ControllerState, Float[Array, " n"]]:
    """Compute tick number `tick`, from one on, of the torques after a tick of the law, at equal times until the next.

    Return the next state and the torques [N m, N], for new measurements of the joints, with model, thrust rates and
    joint velocities of the tick of the law, whose `command` and `terms` these are. Joints that are not measured are
    predicted. Without an answer of the QP the torques are kept.
    """
    tracker, last, commanded = params.between, memory.between, command.joint_velocity
    assert tracker is not None
    assert last is not None
    assert commanded is not None
    with jax.default_matmul_precision("highest"):
        joints = joints_between.update(tracker, last, measured)
        memory, torque = params.torques().solve_again(
            memory, terms.torque_qp, joints.velocity - commanded, terms.limits, joints.are_solved
        )
        memory = memory._replace(between=joints._replace(are_solved=torque.are_solved))
        left = (tracker.steps - tick) / tracker.steps
        acting = torque.joint_torque
        return params.guard(robot).change_torques(memory, terms, acting, left.astype(acting.dtype)), acting


def _command(used: UsedMeasurement, rates: Rates, torque: Torque) -> Command:
    """Return the command, and whether it is that of the control law."""
    held = jnp.where(rates.status == MOMENTUM_HELD, BOTH_HELD, TORQUE_HELD)
    return Command(
        rates.thrust_rate,
        torque.joint_torque,
        joint_velocity=rates.joint_velocity,
        momentum_qp=rates.answer,
        torque_qp=torque.answer,
        status=jnp.where(torque.is_solved, rates.status, held),
        degraded_modes=used.modes,
    )


def replace_command(
    memory: ControllerState,
    command: Command,
    terms: Terms,
    thrust_rate: Float[Array, " j"],
    joint_torque: Float[Array, " n"],
) -> tuple[ControllerState, Command]:
    """Return state and command for actuation until the next tick that differs from the command of this tick.

    The predictions of the channels and the estimator use it. The torques of the control law remain, from which its
    rate limiter continues. `thrust_rate` [N/s], `joint_torque` [N m].
    """
    known, share = memory.channels, terms.limits.torque_share
    change = accelerate(terms.inverse_mass, jnp.pad(share * (joint_torque - command.joint_torque), (6, 0)))
    known = known._replace(acceleration=known.acceleration + change, thrust_rate=thrust_rate)
    memory = memory._replace(channels=known)
    if memory.estimator is not None:
        replaced = estimator.replace_command(memory.estimator, share * joint_torque, thrust_rate)
        memory = memory._replace(estimator=replaced)
    if memory.joints is not None:
        memory = memory._replace(joints=memory.joints._replace(torque=joint_torque))
    if memory.latency is not None:
        memory = memory._replace(latency=memory.latency._replace(torque=joint_torque))
    if memory.between is not None:
        acting = {"torque": joint_torque, "mean_torque": joint_torque, "acceleration": known.acceleration[6:]}
        memory = memory._replace(between=memory.between._replace(**acting))
    return memory, command._replace(thrust_rate=thrust_rate, joint_torque=joint_torque)
