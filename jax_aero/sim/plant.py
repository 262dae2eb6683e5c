"""The simulated flying robot: rigid bodies, thrusts and wind.

    M(q) ν̇ = S τ + Σ Jᵀ T a + w_aero + w_push − h(q, ν)

There is no ground; joint stops act unless they are disabled, and drives if they are configured. The integration is
identical to the Rust crate's.

Equations M78, M79, M87, M140, M142 and M153 to M155 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, ParamSpec, TypeVar, assert_never

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

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
from jax_aero.body.dynamics import accelerate, add_joint_inertia, dynamics, invert_mass
from jax_aero.body.jets import JetDynamics, JetsState, jet_dynamics
from jax_aero.body.kinematics import generalised_thrust, kinematics, move
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotation_from_rpy
from jax_aero.config import (
    DynamicsBackend,
    Integrator,
    JetFaultsConfig,
    LeverArm,
    ScenarioConfig,
)
from jax_aero.sim.jet_faults import faulty_jets
from jax_aero.sim.joint_faults import JointFaults, JointFaultsState, joint_faults
from jax_aero.sim.model_error import simulated_robot
from jax_aero.sim.motors import Motors, MotorsState, motors_of
from jax_aero.sim.pushes import Pushes, pushes_of
from jax_aero.types import Array, Dynamics, InverseMass, Kinematics, LinkForces, State, leaf, pytree, static

Result = TypeVar("Result")
P = ParamSpec("P")

STOP_STIFFNESS = 1e5
"""Stiffness of a joint stop, and of what holds a stuck joint [N m/rad, N/m]: 50 N m deflect it by half a mrad."""
STOP_DAMPING = 200.0
"""Damping of both [N m s/rad, N s/m]: a time constant of 2 ms with the stiffness."""


CHUNK = 250
"""Ticks that a flight computes between checks for a loss and for Ctrl-C."""


def options_of(version: tuple[int, ...]) -> dict[str, bool | int]:
    """Return `COMPILER_OPTIONS` for a version of JAX; from 0.11.1 on XLA has no other generator of code."""
    return {"xla_cpu_use_fusion_emitters": False} if version < (0, 11, 1) else {}


COMPILER_OPTIONS = options_of(jax.__version_info__)
"""Options for `jax.jit(..., compiler_options=COMPILER_OPTIONS)` of flights: on a CPU, XLA's older code generator for
fused operations compiles them faster, and they run no slower (`docs/embedding.md`)."""


def run_once(function: Callable[P, Result]) -> Callable[P, Result]:
    """Compile a function that runs once before a flight without optimisation: to compile it takes far longer.

    In a program that is traced, it is a part of that.
    """
    compiled = jax.jit(function, compiler_options=COMPILER_OPTIONS | {"xla_backend_optimization_level": 0})

    def call(*args: P.args, **named: P.kwargs) -> Result:
        # A number made in a program that is traced is a part of it, too.
        values = jax.tree.leaves((args, named, jnp.zeros(())))
        is_traced = any(isinstance(value, jax.core.Tracer) for value in values)
        return (function if is_traced else compiled)(*args, **named)

    return call


@pytree
class Plant:
    """The simulated plant: numbers are leaves, switches are structure."""

    robot: RobotModel
    aero: AeroModel
    jets: JetDynamics
    force_scale: Float[Array, " j"] | None
    """Ratio of each jet's force to its thrust; `None` if they are equal."""
    motors: Motors | None
    """Drives of the joints; `None` if torques act on the joints themselves."""
    joint_faults: JointFaults | None
    pushes: Pushes | None
    time_step: Float[Array, ""]
    """Time step [s]."""
    lever_arm: LeverArm = static()
    integrator: Integrator = static()
    has_stops: bool = static()
    """Whether joints have stops."""
    substeps: int = static()
    backend: DynamicsBackend = static()


class PlantState(NamedTuple):
    """State of the plant between two ticks."""

    robot: State
    jets: JetsState
    first: State | None
    """State of the first tick, in which links are frozen for the aerodynamics (published); `None` if they move."""
    motors: MotorsState | None
    joint_faults: JointFaultsState | None
    until_pushes: Float[Array, " p"] | None
    """Times until the pushes [s], negative after their starts."""


class Acting(NamedTuple):
    """What acts on the plant in a tick."""

    thrust_rate: Float[Array, " j"]
    """Thrust rates that reach the jets [N/s]."""
    torques: Float[Array, "s n"]
    """Joint torques of each sub-step [N m]."""


class Observation(NamedTuple):
    """Quantities that follow from a plant state and the wind."""

    kinematics: Kinematics
    dynamics: Dynamics
    inverse_mass: InverseMass
    placed: Kinematics
    """Kinematics of the links in the wind: the current or the frozen ones."""
    link_forces: LinkForces


def n_ticks(config: ScenarioConfig) -> int:
    """Return the number of ticks after the one at time zero."""
    return int(np.floor(config.simulator.duration / config.controller.time_step + 0.5))


def n_drawn(config: ScenarioConfig) -> int:
    """Return the ticks after the first for which noise is drawn: whole chunks, so that durations share a program."""
    return -(-(n_ticks(config) + 1) // CHUNK) * CHUNK - 1


def start_plant(
    scenario: ScenarioConfig,
    robot: RobotModel,
    aero: AeroModel | None = None,
    jets: JetDynamics | None = None,
    read_network: ReadNetwork = load_network,
) -> tuple[Plant, PlantState]:
    """Return a plant and its state at the first tick. Call it outside loops, since it draws noise.

    `aero` and `jets` replace the models of the configuration.
    """
    config, disturbances = scenario.simulator, scenario.disturbances
    initial, robot = config.initial, simulated_robot(scenario, robot)
    # A model without fields, such as an empty NamedTuple, counts as false.
    aero = aero_model(config.aero, robot, read_network) if aero is None else aero
    jets = jet_dynamics(config.jets, robot) if jets is None else jets
    force_scale = None
    if disturbances.jets != JetFaultsConfig():
        jets = faulty_jets(jets, disturbances.jets, config.jets, robot, n_drawn(scenario))
        force_scale = leaf([disturbances.jets.force_scale.get(name, 1.0) for name in robot.jets.names])
    plant = Plant(
        robot=robot,
        aero=weight_forces(aero, disturbances.aero, robot),
        jets=jets,
        force_scale=force_scale,
        motors=motors_of(config.motors, robot),
        joint_faults=joint_faults(disturbances.joints, robot),
        pushes=pushes_of(disturbances.pushes, robot),
        time_step=leaf(scenario.controller.time_step),
        lever_arm=config.lever_arm,
        integrator=config.integrator,
        has_stops=config.joint_stops,
        substeps=config.substeps,
        backend=config.dynamics,
    )
    joint_position = leaf(initial.joint_position)
    state = State(
        base_position=leaf(initial.base_position),
        base_rotation=_rotation_from_rpy(np.deg2rad(leaf(initial.base_rpy_deg))),
        joint_position=joint_position,
        velocity=leaf(np.concatenate([initial.base_velocity, np.zeros(robot.n_joints)])),
    )
    # Motors and faulty joints start as they are placed, before the fall.
    motors = None if plant.motors is None else plant.motors.start(state)
    faults = None if plant.joint_faults is None else plant.joint_faults.begin(joint_position)
    if initial.free_fall_tick:
        state = _fall_freely(plant, state)
    first = state if config.kinematics == "frozen" else None
    begun = _start_jets(jets, leaf(initial.thrust))
    until_pushes = None if plant.pushes is None else jnp.asarray(plant.pushes.start)
    return plant, PlantState(state, begun, first, motors, faults, until_pushes)


def zero_state(state: PlantState) -> PlantState:
    """Return a zero state of the same structure, for computing in place of a state that is not finite."""
    zero: PlantState = jax.tree.map(jnp.zeros_like, state)
    rotation = jnp.eye(3, dtype=state.robot.velocity.dtype)
    first = None if zero.first is None else zero.first._replace(base_rotation=rotation)
    return zero._replace(robot=zero.robot._replace(base_rotation=rotation), first=first)


def observe(
    plant: Plant,
    state: PlantState,
    wind: Float[Array, "3"],
    known: tuple[Kinematics, Dynamics, InverseMass] | None = None,
) -> Observation:
    """Return everything that follows from the state and the given wind [m/s].

    `known` are kinematics, dynamics and inverse mass matrix of this robot in this state, if already computed.
    """
    if known is None:
        kin = kinematics(plant.robot, state.robot)
        dyn = dynamics(plant.robot, state.robot, kin, plant.backend)
        known = kin, dyn, invert_mass(dyn)
    kin, dyn, inverse_mass = known
    placed = kin
    if state.first is not None:
        placed = kinematics(plant.robot, state.first._replace(velocity=state.robot.velocity))
    conventions = LinkConventions(lever_arm=plant.lever_arm)
    forces = link_forces(plant.aero, plant.robot, placed, conventions, wind)
    return Observation(kin, dyn, inverse_mass, placed, forces)


def advance(plant: Plant, state: PlantState, seen: Observation, acting: Acting, wind: Float[Array, "3"]) -> PlantState:
    """Advance one tick under what acts in it, from the observation of `state`; later sub-steps observe anew."""
    if plant.joint_faults is not None and state.joint_faults is not None:
        faults = plant.joint_faults.begin_tick(state.joint_faults, plant.time_step, state.robot.joint_position)
        state = state._replace(joint_faults=faults)
    state = _advance_bodies(plant, state, seen, acting.torques[0])
    if plant.substeps > 1:

        def later(state: PlantState, torque: Array) -> tuple[PlantState, None]:
            return _advance_bodies(plant, state, observe(plant, state, wind), torque), None

        state = jax.lax.scan(later, state, acting.torques[1:])[0]
    return state._replace(jets=plant.jets.advance(state.jets, acting.thrust_rate, plant.time_step))


def _advance_bodies(plant: Plant, state: PlantState, seen: Observation, torque: Array) -> PlantState:
    """Advance robot and drives by one sub-step under these torques."""
    robot, kin, step = plant.robot, seen.kinematics, plant.time_step / plant.substeps
    thrust = state.jets.thrust if plant.force_scale is None else plant.force_scale * state.jets.thrust
    # One point for moment and Jacobian; for a rigid body both are equivalent.
    force = (
        generalised_thrust(robot, kin, thrust)
        + generalised_aero_force(robot, seen.placed, seen.link_forces, seen.link_forces.arm_points)
        - seen.dynamics.bias
    )
    if plant.pushes is not None and state.until_pushes is not None:
        force = force + plant.pushes.act(robot, kin, state.until_pushes, step)
        state = state._replace(until_pushes=state.until_pushes - step)
    return _step(plant, state, seen.inverse_mass, force, torque, step)


def _step(
    plant: Plant, state: PlantState, inverse: InverseMass, force: Array, torque: Array, step: Array
) -> PlantState:
    """Take one step under a generalised force, which includes `−h`, and torques, with drives and joint stops."""
    motors = None
    if plant.motors is not None and state.motors is not None:
        motors = plant.motors.lag(state.motors, torque, step)
        torque = motors.torque
    if plant.joint_faults is not None and state.joint_faults is not None:
        torque = plant.joint_faults.reduce(state.joint_faults, torque)
        is_stuck, held = plant.joint_faults.stuck(state.joint_faults, plant.robot.n_joints)
        inverse, force = _hold(plant, state.robot, inverse, force, is_stuck, held, step)
    if plant.motors is not None and motors is not None:
        driven = plant.motors.drive(motors, torque, state.robot, inverse, force, step)
        robot = _move(plant, state.robot, driven.inverse_mass, driven.force, step)
        return state._replace(robot=robot, motors=plant.motors.advance(motors, driven, robot, step))
    force = force + jnp.pad(torque, (6, 0))
    return state._replace(robot=_move(plant, state.robot, inverse, force, step))


def _move(plant: Plant, state: State, inverse: InverseMass, force: Array, step: Array) -> State:
    """Take one step under a generalised force, which includes `−h`, and the joint stops."""
    acceleration = accelerate(inverse, force)
    if plant.has_stops and plant.robot.n_joints:
        lower, upper = jnp.asarray(plant.robot.joint_stops).T
        ahead = _position(plant, state, step) + step * (state.velocity[6:] + step * acceleration[6:])
        is_out = (ahead > upper) | (ahead < lower)
        # Ranges may be infinite, which must not enter derivatives.
        stop = jnp.where(ahead > upper, upper, jnp.where(ahead < lower, lower, 0.0))
        acceleration = accelerate(*_hold(plant, state, inverse, force, is_out, stop, step))
    return integrate(plant, state, acceleration, step)


def _position(plant: Plant, state: State, step: Array) -> Array:
    """Return where the velocity after the step acts: with explicit Euler, the positions at the end of the step."""
    return state.joint_position + (step * state.velocity[6:] if plant.integrator == "explicit_euler" else 0.0)


def _hold(
    plant: Plant, state: State, inverse: InverseMass, force: Array, is_held: Array, rest: Array, step: Array
) -> tuple[InverseMass, Array]:
    """Return inverse mass matrix and force with springs and dampers that hold some joints, at rest in `rest`.

    They are implicit in the velocity after the step and thus stable for every step size.
    """
    velocity = state.velocity[6:]
    push = STOP_STIFFNESS * (_position(plant, state, step) + step * velocity - rest) + STOP_DAMPING * velocity
    added = jnp.where(is_held, step * (step * STOP_STIFFNESS + STOP_DAMPING), 0.0)
    return add_joint_inertia(inverse, added), force - jnp.pad(jnp.where(is_held, push, 0.0), (6, 0))


_rotation_from_rpy = run_once(rotation_from_rpy)


@run_once
def _start_jets(jets: JetDynamics, thrust: Array) -> JetsState:
    return jets.start(thrust)


@run_once
def _fall_freely(plant: Plant, state: State) -> State:
    """Take the first step of the published model, under gravity alone."""
    dyn = dynamics(plant.robot, state, kinematics(plant.robot, state), plant.backend)
    return _move(plant, state, invert_mass(dyn), -dyn.bias, plant.time_step)


def integrate(plant: Plant, state: State, acceleration: Float[Array, " N"], step: Float[Array, ""]) -> State:
    """Take one Euler step of `step` [s]: pose with the new velocity (semi-implicit) or with the old one (explicit)."""
    velocity = state.velocity + step * acceleration
    match plant.integrator:
        case "semi_implicit_euler":
            moving = velocity
        case "explicit_euler":
            moving = state.velocity
        case _:
            assert_never(plant.integrator)
    return move(state, moving, step)._replace(velocity=velocity)
