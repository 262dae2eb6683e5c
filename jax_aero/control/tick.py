"""The flight controller: one tick, from a measurement to thrust rates and joint torques.

`tick` has the order of computation: measure, model, observe, law, torques, predict. It is a pure function of one
sample; use `vmap`, `jit`, `grad` and `scan` on it. Ticks are one time step apart.

>>> params = momentum_controller(config, robot)
>>> memory = init(params, robot, state)
>>> memory, command, terms = tick(params, robot, memory, time, state, thrust, wind)

The unknowns of the momentum QP are `u = (Ṫ, ṡ)`, thrust rates and joint velocities.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.aero import AeroModel, LinkConventions, ReadNetwork, aero_model, weight_forces
from jax_aero.aero.network_card import load_network
from jax_aero.body.dynamics import dynamics
from jax_aero.body.jets import Engines, engines, predict_thrust
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import multiply
from jax_aero.config import RateFeedback, ScenarioConfig
from jax_aero.control import qp
from jax_aero.control.command import Command
from jax_aero.control.estimate import disturbance_observer, estimator, wind_observer
from jax_aero.control.estimate.disturbance_observer import ObserverGains
from jax_aero.control.estimate.estimator import Estimator, EstimatorModel, Order
from jax_aero.control.law import setpoint as generator
from jax_aero.control.law.attitude import MomentumGains
from jax_aero.control.law.mission import Mission, load_mission
from jax_aero.control.law.momentum_qp import Task
from jax_aero.control.law.plan import no_plan
from jax_aero.control.law.policy_card import load_policy
from jax_aero.control.law.rates import MomentumLaw
from jax_aero.control.law.residual import Residual, Steering, steer
from jax_aero.control.law.setpoint import SetpointParams
from jax_aero.control.law.tasks import TaskParams, choose_limits, symmetric_pairs, task_params
from jax_aero.control.law.torque import TorqueParams
from jax_aero.control.law.torques import Torques
from jax_aero.control.measurement import Measurement, Reading
from jax_aero.control.mpc.config import Mpc, mpc_params
from jax_aero.control.mpc.law import PredictiveLaw
from jax_aero.control.preview import Preview
from jax_aero.control.state import ControllerState, EnginesState, start_engines
from jax_aero.control.terms import Model, Terms, update_model
from jax_aero.refusals import refuse
from jax_aero.rust import MODES
from jax_aero.types import Array, Setpoint, State, leaf, leaves, pytree, static, where


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
    observes_wind: bool
    """Whether the wind is estimated from the wrench in place of the measured one."""


@pytree
class MomentumController:
    """The flight controller, a `Controller`: every number is a leaf, the switches are structure."""

    switches: Switches = static()
    aero: AeroModel
    """The controller's aerodynamic model."""
    engines: Engines | None
    """Engines that follow the thrust rates; `None` if thrusts do so themselves."""
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
    friction: Float[Array, " n"] | None
    """Dry friction of the drives [N m]; `None` if it is not compensated."""
    setpoint: SetpointParams
    estimator: Estimator | None
    """State estimator that replaces the measured state; `None` without one."""
    observer: ObserverGains | None
    """Observer of the unmodelled wrench; `None` without one."""
    mpc: Mpc | None
    """The predictive law; `None` where the momentum QP decides."""
    mission: Mission
    time_step: Float[Array, ""]
    """[s]."""
    residual: Residual | None = None
    """What is added to the answer of the law; `None` for nothing."""

    def momentum_law(self) -> MomentumLaw:
        """Return the momentum law, from the set-point to thrust rates and joint velocities."""
        return MomentumLaw(
            self.momentum,
            self.setpoint,
            self.mission,
            self.tasks,
            self.switches.symmetric_pairs,
            self.other_tasks,
            self.switches.latency,
            self.switches.lead,
        )

    def law(self) -> MomentumLaw | PredictiveLaw:
        """Return the law that decides: the predictive one, if there is one."""
        if self.mpc is None:
            return self.momentum_law()
        conventions, gains = self.switches.conventions, (self.torque.kd, self.torque.kp)
        momentum = self.momentum_law()
        return PredictiveLaw(self.mpc, self.engines, momentum, self.aero, conventions, gains, self.time_step)

    def torques(self) -> Torques:
        """Return the torque law."""
        return Torques(self.torque, self.friction, self.torque_max, self.torque_rate_max, self.time_step)

    def model(self, robot: RobotModel, now: Measurement) -> Model:
        """Return the values of a tick that depend on the measurement only."""
        switches = self.switches
        return update_model(
            robot,
            self.aero,
            switches.conventions,
            self.rate_feedback,
            lambda_feedback=switches.lambda_a,
            torque_feedback=switches.torque,
            now=now,
        )

    def init(self, robot: RobotModel, state: State) -> ControllerState:
        """Return the state of the controller at the first tick; see `init`."""
        return init(self, robot, state)

    def step(
        self, robot: RobotModel, memory: ControllerState, measurement: Measurement
    ) -> tuple[ControllerState, Command]:
        """Compute one tick on the configured mission; see `tick`."""
        known = measurement.time, measurement.state, measurement.thrust, measurement.wind
        memory, command, terms = tick(self, robot, memory, *known, preview=measurement.preview)
        return memory, command._replace(setpoint=terms.setpoint, terms=terms)


def momentum_controller(
    config: ScenarioConfig,
    robot: RobotModel,
    read_network: ReadNetwork = load_network,
    tasks: tuple[Task, ...] = (),
) -> MomentumController:
    """Return the controller of a robot as configured. Call it outside loops, since it computes interpolation tables.

    `robot` is the controller's model of the robot; `tasks` are user-defined objectives, added to the controller's own.
    What watches for failures is left out; see `jax_aero.sim.prepare`.

    Raises
    ------
    ValueError
        If the law is none of JAX's, such as that of feet (`jax_aero.refusals`); the message names the key.
    """
    refuse(config, of_law=True)
    controller, time_step = config.controller, leaf(config.controller.time_step)
    feedback, aero = controller.aero_feedback, aero_model(controller.aero, robot, read_network)
    estimates = controller.estimator
    return MomentumController(
        switches=Switches(
            LinkConventions(
                controller.lever_arm,
                controller.jacobian_offset,
                controller.link_velocity,
                None if controller.axes_of is None else robot.aero_links.names.index(controller.axes_of),
            ),
            lambda_a=feedback.lambda_,
            torque=feedback.torque,
            symmetric_pairs=symmetric_pairs(controller, robot),
            latency=0.0 if estimates is None else estimates.latency.torque,
            lead=0 if estimates is None else estimator.latency_in_ticks(estimates.latency, float(time_step))[0],
            observes_wind=controller.wind_observer,
        ),
        aero=weight_forces(aero, config.disturbances.aero_estimate, robot),
        engines=engines(robot, robot.jets.engines) if controller.jet_dynamics == "throttled" else None,
        rate_feedback=_components(feedback.momentum_rate),
        momentum=leaves(MomentumGains, controller.momentum),
        tasks=task_params(controller, robot),
        other_tasks=tasks,
        torque=leaves(TorqueParams, controller.torque),
        torque_max=choose_limits(robot.joint_torque_max, controller.torque.torque_max, robot),
        torque_rate_max=choose_limits(robot.joint_torque_rate_max, controller.torque.torque_rate_max, robot),
        friction=_friction(controller.torque.friction, robot),
        setpoint=generator.setpoint_params(controller.setpoint, robot.forward_axis, time_step),
        estimator=None if estimates is None else estimator.estimator(estimates, time_step),
        observer=None
        if controller.disturbance_observer is None
        else leaves(ObserverGains, controller.disturbance_observer),
        mpc=None if controller.mpc is None else mpc_params(controller.mpc, robot, config.controller.time_step),
        mission=load_mission(config.mission),
        time_step=time_step,
        residual=None if controller.policy is None else load_policy(controller.policy.card, robot),
    )


def _components(known: RateFeedback) -> Array:
    """Return 1 for each known component (6,) of a wrench, 0 for the others."""
    has_force, has_moment = known in ("wrench", "force"), known in ("wrench", "moment")
    return leaf(np.repeat([has_force, has_moment], 3))


def _friction(by_group: Mapping[str, float] | None, robot: RobotModel) -> Array | None:
    """Return the friction of each joint's drive (n,) [N m], if there is any; a prismatic joint has none."""
    friction = np.zeros(robot.n_joints)
    for group, joints in robot.joint_groups:
        friction[list(joints)] = (by_group or {}).get(group, 0.0)
    friction *= robot.joint_turns
    return leaf(friction) if friction.any() else None


def init(params: MomentumController, robot: RobotModel, state: State) -> ControllerState:
    """Return the controller's state at the first tick, whose position, attitude and posture become the set-point."""
    kin = kinematics(robot, state)
    inertia, rotation = dynamics(robot, state, kin).centroidal_inertia, state.base_rotation
    n, jets, zeros = robot.n_joints, params.tasks.thrust_rate.shape[0], jnp.zeros_like(state.joint_position)
    return ControllerState(
        setpoint=generator.start(params.setpoint, kin.com, rotation),
        posture=jnp.asarray(state.joint_position),
        inertia_0=multiply(multiply(rotation.T, inertia), rotation),
        velocity_error_integral=zeros,
        joint_torque=zeros,
        torque_is_known=jnp.array(False),
        momentum_start=qp.cold_start(jets + n, zeros.dtype),
        torque_start=qp.cold_start(n, zeros.dtype),
        estimator=None
        if params.estimator is None
        else estimator.start(params.estimator, state, jets, has_engines=params.engines is not None),
        engines=None
        if params.engines is None or params.estimator is not None
        else start_engines(jnp.zeros(jets, zeros.dtype)),
        wind=wind_observer.start(zeros) if params.switches.observes_wind else None,
        observer=None if params.observer is None else disturbance_observer.start(zeros),
        plan=None if params.mpc is None else no_plan(params.mpc.structure.unknowns(jets), jets, zeros.dtype),
        residual=None if params.residual is None else disturbance_observer.start(zeros),
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
    preview: Preview | None = None,
) -> tuple[ControllerState, Command, Terms]:
    """Compute one tick; return the next state, the command, and every intermediate value.

    `time` [s], `thrust` [N], `wind` [m/s, inertial axes]. A given `setpoint` replaces the mission. `preview` is what is
    known of the future.

    The estimator, if configured, uses the measured state and thrusts; the observer of the wind, if configured, replaces
    the measured wind by its estimate from the ticks before. Every number of a measurement has to be finite.
    """
    measurement = Measurement(time, state, thrust, wind, Preview() if preview is None else preview)
    with jax.default_matmul_precision("highest"):
        memory, estimates = _measure(params, robot, memory, measurement)
        memory, model = _observe(params, memory, params.model(robot, estimates))
        wind_std = jnp.zeros_like(wind) if memory.wind is None else memory.wind.std
        memory, command, terms = decide(params, robot, memory, estimates, model, setpoint)
        terms = terms._replace(wind_std=wind_std)
        return _predict(params, robot, memory, terms, command), command, terms


def decide(
    params: MomentumController,
    robot: RobotModel,
    memory: ControllerState,
    estimates: Measurement,
    model: Model,
    setpoint: Setpoint | None = None,
) -> tuple[ControllerState, Command, Terms]:
    """Compute the part of a tick that is the law's, from the estimates and the model that follows from them."""
    added = None
    memory, followed = params.momentum_law().follow(memory, estimates.time, setpoint)
    if isinstance(params.residual, Steering) and params.residual.replaces:
        # What an environment replaces need not be solved.
        law = params.momentum_law()
        rates = law.leave_open(law.prepare(robot, memory, estimates, model, followed))
    else:
        memory, rates = params.law().solve(robot, memory, estimates, model, followed)
    if params.residual is not None:
        known = robot, params.time_step, memory, estimates, model, followed.due
        memory, rates, added = steer(params.residual, *known, rates)
    memory, torque = params.torques().solve(memory, estimates.state, model, rates)
    command = Command(
        rates.thrust_rate,
        torque.joint_torque,
        joint_velocity=rates.joint_velocity,
        momentum_qp=rates.answer,
        torque_qp=torque.answer,
        degraded_modes=rates.modes | jnp.where(torque.is_solved, 0, MODES["torque_held"]),
    )
    terms = Terms(
        estimates=estimates,
        wind_std=jnp.zeros_like(estimates.wind),
        kinematics=model.kinematics,
        dynamics=model.dynamics,
        inverse_mass=model.inverse_mass,
        link_forces=model.link_forces,
        momentum=model.momentum,
        setpoint=rates.setpoint,
        attitude=rates.attitude,
        momentum_qp=rates.momentum_qp,
        torque_qp=torque.torque_qp,
        unlimited_torque=torque.unlimited_torque,
        friction=torque.friction,
        residual=added,
    )
    return memory, command, terms


def _measure(
    params: MomentumController, robot: RobotModel, memory: ControllerState, measurement: Measurement
) -> tuple[ControllerState, Measurement]:
    """Replace what is measured by what is estimated of it."""
    if memory.wind is not None:
        measurement = measurement._replace(wind=memory.wind.wind)
    if params.estimator is not None and memory.estimator is not None:
        reading, known = (
            Reading(measurement.state, measurement.thrust),
            EstimatorModel(robot, params.aero, params.engines),
        )
        estimating, estimate, rate = estimator.update(params.estimator, known, memory.estimator, reading)
        reading = where(estimator.is_possible(robot, estimate), estimate, reading)
        measurement = measurement._replace(state=reading.state, thrust=reading.thrust, thrust_rate=rate)
        memory = memory._replace(estimator=estimating)
    if memory.engines is not None:
        thrust, rate, command, has_command = memory.engines
        step, least = params.time_step, robot.jets.thrust_min
        rate = jnp.where(has_command, predict_thrust(thrust, rate, command, step, least, params.engines)[1], rate)
        measurement = measurement._replace(thrust_rate=rate)
    return memory, measurement


def _observe(params: MomentumController, memory: ControllerState, model: Model) -> tuple[ControllerState, Model]:
    """Add the observed wrench to the momentum rate."""
    if params.observer is None or memory.observer is None:
        return memory, model
    momentum, rate = model.dynamics.momentum, model.momentum.rate_estimate
    observed = disturbance_observer.update(params.observer, params.time_step, memory.observer, momentum, rate)
    model = model._replace(momentum=model.momentum.add_unmodelled(observed.wrench))
    return memory._replace(observer=observed), model


def _predict(
    params: MomentumController, robot: RobotModel, memory: ControllerState, terms: Terms, command: Command
) -> ControllerState:
    """Store what the next tick expects: the wind, and what engines and the estimator's model do under the command."""
    now = terms.estimates
    if memory.wind is not None:
        seen = terms.kinematics, terms.dynamics.momentum, terms.momentum.a_t, now.thrust
        wind = wind_observer.update(robot, params.aero, params.time_step, memory.wind, *seen)
        memory = memory._replace(wind=wind)
    if memory.engines is not None and now.thrust_rate is not None:
        has_command = jnp.ones_like(memory.engines.has_command)
        memory = memory._replace(engines=EnginesState(now.thrust, now.thrust_rate, command.thrust_rate, has_command))
    if memory.estimator is None:
        return memory
    torque = command.joint_torque if terms.friction is None else command.joint_torque - terms.friction
    order = Order(torque, command.thrust_rate, terms.momentum.unmodelled_wrench, now.wind)
    return memory._replace(estimator=estimator.command(memory.estimator, order))


def replace_command(
    memory: ControllerState, command: Command, thrust_rate: Float[Array, " j"], joint_torque: Float[Array, " n"]
) -> tuple[ControllerState, Command]:
    """Return state and command for actuation until the next tick that differs from the command of this tick.

    The estimator uses it. The torques of the control law remain, from which its rate limiter continues.
    `thrust_rate` [N/s], `joint_torque` [N m].
    """
    if memory.estimator is not None:
        more = joint_torque - command.joint_torque
        memory = memory._replace(estimator=estimator.replace_command(memory.estimator, more, thrust_rate))
    if memory.engines is not None:
        memory = memory._replace(engines=memory.engines._replace(command=thrust_rate))
    return memory, command._replace(thrust_rate=thrust_rate, joint_torque=joint_torque)
