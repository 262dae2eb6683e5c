"""The flight controller: one tick, from a measurement to thrust rates and joint torques.

`tick` follows the order of the controller: estimates of state and wind, set-point, kinematics and dynamics, aerodynamic
forces, momentum, tasks, QP, torques. It is a pure function of one sample; use `vmap`, `jit`, `grad` and `scan` on it.

>>> params = momentum_controller(config, robot)
>>> memory = init(params, robot, state)
>>> memory, command, terms = tick(params, robot, memory, time, state, thrust, wind)

The unknowns of the momentum QP are `u = (Ṫ, ṡ)`, thrust rates and joint velocities. Equation M101 of `docs/model.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.aero import (
    AeroModel,
    LinkConventions,
    ReadNetwork,
    aero_model,
    generalised_aero_force,
    link_forces,
    weight_forces,
)
from jax_aero.aero.network_card import load_network
from jax_aero.config import MissionConfig, RateFeedback, ScenarioConfig
from jax_aero.control import channels, engines, estimator, observer, qp, wind_observer
from jax_aero.control import setpoint as generator
from jax_aero.control.attitude import TaskGains, attitude_demand
from jax_aero.control.bounds import rate_bounds
from jax_aero.control.channels import ChannelLimits, ChannelsState, UsedMeasurement, channel_limits
from jax_aero.control.engines import EngineLimits, EngineState
from jax_aero.control.estimator import Estimator, EstimatorState, Order, Reading
from jax_aero.control.momentum import momentum_model
from jax_aero.control.observer import ObserverGains, ObserverState
from jax_aero.control.protocol import Command, Measurement, Terms
from jax_aero.control.qp import WarmStart
from jax_aero.control.recorded import Recording, read_reference, recording
from jax_aero.control.setpoint import Commands, SetpointParams, SetpointState
from jax_aero.control.tasks import (
    Task,
    TaskInputs,
    TaskParams,
    choose_limits,
    momentum_qp,
    symmetric_pairs,
    task_params,
)
from jax_aero.control.torque import TorqueParams, limit_rate, torque_qp
from jax_aero.control.wind_observer import WindObserver, WindState
from jax_aero.dynamics import dynamics, forward_dynamics
from jax_aero.kinematics import generalised_force, kinematics
from jax_aero.robot import RobotModel
from jax_aero.spatial import cross, multiply
from jax_aero.types import Array, Setpoint, State, Static, leaf, leaves, pytree, where

NOMINAL, DEGRADED, MOMENTUM_HELD, TORQUE_HELD, BOTH_HELD = range(5)
"""Codes of `Command.status`, which says whether the control law produced the command, as in the Rust crate.

Degraded: a part of the measurement was predicted, or the robot is descending; see `Command.degraded_modes`. Momentum
held: the momentum QP has no certified answer; rates and velocities are as near to zero as their bounds allow, and
torques brake the joints. Torque held: the torque QP has no certified answer; torques keep their last values.
"""

INTEGRAL_LIMIT = 20.0
"""Saturation of the published integrator of the joint velocity error [rad]; no flight comes near it."""


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


@pytree
class MomentumController:
    """The flight controller, a `Controller`: every number is a leaf, the switches are structure."""

    switches: Static[Switches]
    aero: AeroModel
    """The controller's aerodynamic model."""
    rate_feedback: Float[Array, "6"]
    """1 or 0: which components of the total estimated wrench enter the momentum rate."""
    momentum: TaskGains
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
    mission: Commands | Recording
    """Mission: the autopilot's commands or recorded set-points."""
    time_step: Float[Array, ""]
    """[s]."""

    def init(self, robot: RobotModel, state: State) -> ControllerState:
        """Return the state of the controller at the first tick; see `init`."""
        return init(self, robot, state)

    def step(
        self, robot: RobotModel, memory: ControllerState, measurement: Measurement
    ) -> tuple[ControllerState, Command]:
        """Compute one tick on the configured mission; see `tick`."""
        memory, command, terms = tick(self, robot, memory, *measurement)
        return memory, command._replace(setpoint=terms.setpoint, terms=terms)


class ControllerState(NamedTuple):
    """State of the controller between two ticks."""

    setpoint: SetpointState
    channels: ChannelsState
    """State of the measurement's channels."""
    posture: Float[Array, " n"]
    """Posture to return to, `s_d`: the joint positions of the first tick [rad]."""
    inertia_0: Float[Array, "3 3"]
    """Centroidal inertia in body axes at the first tick [kg m²]."""
    velocity_error_integral: Float[Array, " n"]
    """`∫(ṡ − ṡ*)` [rad]."""
    joint_torque: Float[Array, " n"]
    """Last commanded torques [N m]."""
    torque_is_known: Bool[Array, ""]
    """Whether the rate limiter has a last torque."""
    estimator: EstimatorState | None
    """State of the estimator; `None` without one."""
    wind: WindState | None
    """Estimated wind of the next tick; `None` without a wind observer."""
    observer: ObserverState | None
    """Observed wrench and the measurement to compare the next one with; `None` without an observer."""
    engines: EngineState | None
    """State of the engines' detection; `None` without one."""
    momentum_start: WarmStart
    """Starting point of the momentum QP."""
    torque_start: WarmStart
    """Starting point of the torque QP."""


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
    controller, time_step = config.controller, jnp.asarray(config.simulator.time_step, float)
    if controller.contact is not None or not controller.use_jets:
        key, value = ("contact", "given") if controller.contact is not None else ("use_jets", "false")
        raise ValueError(f"`controller.{key}` is {value}; expected a controller that flies: JAX has no feet")
    feedback, aero = controller.aero_feedback, aero_model(controller.aero, robot, read_network)
    estimates, winds = controller.estimator, controller.wind_observer
    return MomentumController(
        switches=Switches(
            LinkConventions(controller.lever_arm, controller.jacobian_offset, controller.link_velocity),
            lambda_a=feedback.lambda_,
            torque=feedback.torque,
            symmetric_pairs=symmetric_pairs(controller, robot),
        ),
        aero=weight_forces(aero, config.disturbances.aero_estimate, robot, "disturbances.aero_estimate"),
        rate_feedback=_components(feedback.momentum_rate),
        momentum=leaves(TaskGains, controller.momentum),
        tasks=task_params(controller, robot, config.simulator.time_step),
        other_tasks=tasks,
        torque=leaves(TorqueParams, controller.torque),
        torque_max=choose_limits(robot.joint_torque_max, controller.torque.torque_max, robot),
        torque_rate_max=choose_limits(robot.joint_torque_rate_max, controller.torque.torque_rate_max, robot),
        setpoint=generator.setpoint_params(controller.setpoint, robot.forward_axis, time_step),
        channels=channel_limits(controller, robot, config.simulator.divergence),
        estimator=None if estimates is None else estimator.estimator(estimates, time_step),
        wind_observer=None if winds is None else leaves(WindObserver, winds),
        observer=None if controller.observer is None else leaves(ObserverGains, controller.observer),
        engines=None if controller.engines is None else engines.engine_limits(controller.engines, robot),
        mission=_mission(config.mission),
        time_step=time_step,
    )


def _mission(mission: MissionConfig) -> Commands | Recording:
    return generator.commands(mission) if mission.file is None else recording(read_reference(mission.file))


def _components(known: RateFeedback) -> Array:
    """Return 1 for each known component (6,) of a wrench, 0 for the others."""
    has_force, has_moment = known in ("wrench", "force"), known in ("wrench", "moment")
    return leaf(np.repeat([has_force, has_moment], 3))


def init(params: MomentumController, robot: RobotModel, state: State) -> ControllerState:
    """Return the controller's state at the first tick, whose position, attitude and posture become the set-point."""
    kin = kinematics(robot, state)
    inertia = dynamics(robot, state, kin).centroidal_inertia
    rotation, n, jets = state.base_rotation, robot.n_joints, params.tasks.thrust_rate.shape[0]
    zeros = jnp.zeros_like(state.joint_position)
    return ControllerState(
        setpoint=generator.start(params.setpoint, kin.com, rotation),
        channels=channels.start(robot, state),
        posture=jnp.asarray(state.joint_position),
        inertia_0=multiply(multiply(rotation.T, inertia), rotation),
        velocity_error_integral=zeros,
        joint_torque=zeros,
        torque_is_known=jnp.array(False),
        estimator=None if params.estimator is None else estimator.start(params.estimator, state, jets),
        wind=None if params.wind_observer is None else wind_observer.start(params.wind_observer),
        observer=None if params.observer is None else observer.start(zeros),
        engines=None if params.engines is None else engines.start(jnp.zeros_like(params.tasks.thrust_rate)),
        momentum_start=qp.cold_start(jets + n, zeros.dtype),
        torque_start=qp.cold_start(n, zeros.dtype),
    )


def tick(
    params: MomentumController,
    robot: RobotModel,
    memory: ControllerState,
    time: Float[Array, ""],
    state: State,
    thrust: Float[Array, " j"],
    wind: Float[Array, "3"],
    setpoint: Setpoint | None = None,
) -> tuple[ControllerState, Command, Terms]:
    """Compute one tick; return the next state, the command, and every intermediate value.

    `time` [s], `thrust` [N], `wind` [m/s, inertial axes]. A given `setpoint` replaces the mission; during a descent
    neither is followed.

    The estimator, if configured, uses the accepted part of state and thrusts; the wind observer, if configured,
    replaces the measured wind by its estimate from the previous ticks. Missing or implausible parts of the measurement
    are predicted; the command's `degraded_modes` names them.
    """
    with jax.default_matmul_precision("highest"):
        wind_std = jnp.zeros_like(wind)
        if memory.wind is not None:
            wind, wind_std = memory.wind.wind, memory.wind.std
        estimates = Measurement(time, state, thrust, wind)
        known, used = channels.update(params.channels, memory.channels, params.time_step, *estimates)
        memory = memory._replace(channels=known)
        if params.estimator is not None and memory.estimator is not None:
            measured = Reading(*channels.select_accepted(known, used))
            before = estimator.restart(memory.estimator, used.pause > 0.0)
            estimating, estimate, innovation = estimator.update(
                params.estimator, robot, params.aero, before, measured, used.elapsed
            )
            memory = memory._replace(estimator=estimating)
            used = channels.replace(params.channels, *estimate, used)._replace(thrust_innovation=innovation)
            estimates = estimates._replace(state=used.state, thrust=used.thrust)
        if setpoint is None:
            along = generator.update(params.setpoint, params.mission, memory.setpoint, used.time)
        else:
            along = generator.follow(params.setpoint, memory.setpoint, generator.motion_of(setpoint)), setpoint
        down = generator.descend(params.setpoint, memory.setpoint)
        moved, followed = where(known.is_descending, down, along)
        after, command, terms = _act(
            params, robot, memory._replace(setpoint=moved), estimates, used, wind_std, followed
        )
        if params.wind_observer is not None and after.wind is not None:
            blowing = wind_observer.update(params.wind_observer, robot, params.aero, after.wind, terms)
            after = after._replace(wind=blowing)
        if after.estimator is not None:
            unmodelled = terms.momentum.unmodelled_wrench
            order = Order(command.joint_torque, command.thrust_rate, unmodelled, used.wind, params.time_step)
            after = after._replace(estimator=estimator.command(after.estimator, order))
        return after, command, terms


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
    # ν̇ is linear in the torques: it changes by M⁻¹ S (τ′ − τ).
    dyn, known = terms.dynamics, memory.channels
    change = forward_dynamics(dyn, dyn.bias.at[6:].add(joint_torque - command.joint_torque))
    known = known._replace(acceleration=known.acceleration + change, thrust_rate=thrust_rate)
    memory = memory._replace(channels=known)
    if memory.estimator is not None:
        memory = memory._replace(estimator=estimator.replace_command(memory.estimator, joint_torque, thrust_rate))
    return memory, command._replace(thrust_rate=thrust_rate, joint_torque=joint_torque)


def _act(
    params: MomentumController,
    robot: RobotModel,
    memory: ControllerState,
    estimates: Measurement,
    used: UsedMeasurement,
    wind_std: Array,
    setpoint: Setpoint,
) -> tuple[ControllerState, Command, Terms]:
    """Compute the tick from a usable measurement."""
    switches = params.switches
    _, state, thrust, wind, modes, innovation, elapsed, _, has_momentum = used
    known = memory.channels
    kin = kinematics(robot, state)
    dyn = dynamics(robot, state, kin)
    link = link_forces(params.aero, robot, kin, switches.conventions, wind)
    momentum = momentum_model(
        robot, kin, dyn, thrust, link, rate_feedback=params.rate_feedback, lambda_feedback=switches.lambda_a
    )
    observed = memory.observer
    if params.observer is not None and observed is not None:
        rate = momentum.rate_estimate
        compared = observer.update(params.observer, elapsed, observed, dyn.momentum, rate)
        observed = where(has_momentum, compared, observer.hold(observed))
        momentum = momentum.add_unmodelled(observed.wrench)
    gains, tasks, torque_rate_max = params.momentum, params.tasks, params.torque_rate_max
    before = memory.engines
    turning = before
    if params.engines is not None and before is not None:
        residual = jnp.zeros_like(dyn.momentum) if observed is None else observed.residual
        share = jnp.ones_like(elapsed) if params.estimator is None else params.estimator.momentum_share
        turning, is_wrong, deviation = engines.update(
            params.engines, before, elapsed, thrust, innovation, momentum.a_t, residual, has_momentum, share
        )
        known = channels.reject_sensor(known, is_wrong, deviation)
        if memory.estimator is not None:
            right = estimator.correct_thrusts(memory.estimator, is_wrong, deviation)
            memory = memory._replace(estimator=right)
        descent = params.engines.descent
        if descent is not None:
            is_lost = jnp.any(turning.is_lost(descent))
            known = known._replace(is_descending=known.is_descending | is_lost)
            fast = tasks._replace(joint_velocity_max=jnp.maximum(tasks.joint_velocity_max, descent.joint_velocity_max))
            gains = where(is_lost, descent.momentum, gains)
            tasks = where(is_lost, fast, tasks)
            torque_rate_max = jnp.maximum(torque_rate_max, jnp.where(is_lost, descent.torque_rate_max, 0.0))
            setpoint = where(is_lost, generator.without_place(setpoint, kin.com), setpoint)
        modes = modes | jnp.where(jnp.any(turning.is_limited), channels.MODES["engine_limited"], 0)

    # Thrust rates and joint velocities that control momentum and attitude.
    attitude = attitude_demand(
        gains,
        setpoint,
        state.base_rotation,
        state.velocity[3:6],
        momentum.rate_estimate[3:],
        memory.inertia_0,
    )
    inputs = TaskInputs(
        gains,
        robot,
        state,
        thrust,
        kin,
        dyn,
        momentum,
        setpoint,
        attitude,
        memory.inertia_0,
        memory.posture,
    )
    shaping = momentum_qp(tasks, switches.symmetric_pairs, inputs, params.other_tasks)
    if turning is not None:
        # The other engines compensate for one that does not reach its thrust.
        greatest = jnp.minimum(turning.greatest, robot.jets.thrust_max)
        least, problem = jnp.minimum(turning.least, greatest), shaping.problem
        lower, upper = rate_bounds(thrust, least, greatest, tasks.thrust_rate_max, tasks.thrust_steepness)
        jets = thrust.shape[0]
        problem = problem._replace(lower=problem.lower.at[:jets].set(lower), upper=problem.upper.at[:jets].set(upper))
        shaping = shaping._replace(problem=problem)
    wanted = qp.solve(shaping.problem, memory.momentum_start)
    momentum_solved = wanted.status == qp.SOLVED
    # As near to rest as the bounds allow.
    u = jnp.where(momentum_solved, wanted.x, jnp.clip(0.0, shaping.problem.lower, shaping.problem.upper))
    thrust_rate, joint_velocity = u[: thrust.shape[0]], u[thrust.shape[0] :]

    # Torques with which the joints follow the commanded velocities.
    jet_forces = thrust[:, None] * momentum.jet_axes
    force = generalised_force(robot, kin, robot.jets.bodies, momentum.jet_points, jet_forces) - dyn.bias
    if switches.torque:
        force = force + generalised_aero_force(robot, kin, link, link.jacobian_points)
    velocity_error = state.velocity[6:] - joint_velocity
    following = torque_qp(
        params.torque, params.torque_max, dyn.mass_matrix, force, velocity_error, memory.velocity_error_integral
    )
    pushed = qp.solve(following.problem, memory.torque_start)
    torque_solved = pushed.status == qp.SOLVED
    # The published rate limiter starts from its first input.
    last = jnp.where(memory.torque_is_known, memory.joint_torque, pushed.x)
    limited = limit_rate(last, pushed.x, torque_rate_max * params.time_step)
    joint_torque = jnp.where(torque_solved, limited, memory.joint_torque)

    held = jnp.array([[BOTH_HELD, TORQUE_HELD], [MOMENTUM_HELD, NOMINAL]], jnp.int32)
    status = held[torque_solved.astype(jnp.int32), momentum_solved.astype(jnp.int32)]
    is_solved = status == NOMINAL
    command = Command(
        thrust_rate,
        joint_torque,
        joint_velocity=joint_velocity,
        momentum_qp=wanted,
        torque_qp=pushed,
        status=jnp.where(is_solved & (modes != 0), DEGRADED, status),
        degraded_modes=modes,
    )
    # Forward Euler: the integral is used before it is advanced. It is not advanced in a tick without a commanded
    # velocity, which has no error, or with held torques, which do not respond to it.
    advanced = jnp.clip(
        memory.velocity_error_integral + params.time_step * velocity_error, -INTEGRAL_LIMIT, INTEGRAL_LIMIT
    )
    # M101: motion under the command until the next tick; the observed wrench acts on the base.
    wrench = momentum.unmodelled_wrench
    moment = wrench[3:] + cross(kin.com - state.base_position, wrench[:3])
    acting = jnp.concatenate([wrench[:3], moment, joint_torque])
    acceleration = forward_dynamics(dyn, force + dyn.bias + acting)
    after = memory._replace(
        channels=known._replace(acceleration=acceleration, thrust_rate=thrust_rate),
        velocity_error_integral=jnp.where(is_solved, advanced, memory.velocity_error_integral),
        joint_torque=joint_torque,
        torque_is_known=memory.torque_is_known | torque_solved,
        observer=observed,
        engines=turning,
        momentum_start=wanted.warm_start,
        torque_start=pushed.warm_start,
    )
    of = state if params.channels.may_predict else estimates.state
    terms = Terms(
        estimates, used, wind_std, of, kin, dyn, link, momentum, setpoint, attitude, shaping, following, pushed.x
    )
    return after, command, terms
