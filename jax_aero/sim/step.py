"""One tick of the closed-loop flight: the order of things that binds plant and controller.

At tick k, t = k h:

    observe   kinematics and aerodynamic forces at x_k in the wind of t
    control   thrust rates and torques from (x_k, T_k, wind), held until the next tick
    record    and stop if the flight is lost
    advance   x_{k+1} from x_k, T_k and the torques;  T_{k+1} = T_k + h Ṫ*

as in the Rust crate. A lost flight stays where it was lost: its status is sticky, and later rows repeat.

Equations M77 and M80 of `docs/model.md`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jax_aero.config import FallConfig, FlightConfig, WindConfig
from jax_aero.control import tick as control
from jax_aero.control.tick import Command, ControllerParams, ControllerState, Terms
from jax_aero.control.wind_estimate import WindEstimate, told_wind, wind_estimate
from jax_aero.dynamics import Backend
from jax_aero.jet_faults import known_limits
from jax_aero.jets import thrust_feedback
from jax_aero.robot import RobotModel
from jax_aero.sim import plant as world
from jax_aero.sim.plant import Observation, Plant, PlantState
from jax_aero.sim.wind import wind_velocity
from jax_aero.spatial import multiply, rotation_angle, rpy_from_rotation, safe_norm, wxyz_from_rotation
from jax_aero.types import Array, State, pytree, where

FLYING, LOST_BY_ROTATION, LOST_BY_COM, LOST_NOT_FINITE = range(4)
"""Codes of `FlightState.fall`."""


@pytree
class Flight:
    """Everything that does not change in a flight. Every number is a leaf: batch and differentiate what you like."""

    plant: Plant
    controller: ControllerParams
    wind: WindConfig
    fall: FallConfig
    believed_robot: RobotModel | None
    """Controller's model of the robot; `None` if it is the simulated one."""
    wind_estimate: WindEstimate | None
    """Errors of the measured wind; `None` if there are none."""


class FlightState(NamedTuple):
    """State of a flight between ticks."""

    plant: PlantState
    memory: ControllerState
    told_wind: Array
    """(3,) last measured wind [m/s]."""
    fall: Array
    """() int32: `FLYING`, or by which criterion the flight was lost."""
    fall_error: Array
    """() what was exceeded, in the criterion's unit."""
    fall_tick: Array
    """() int32: tick at which the flight was lost, −1 while it flies."""


class FlightRow(NamedTuple):
    """One tick of the log; the same signals as the Rust crate's, named alike."""

    time: Array
    base_position: Array
    base_quaternion: Array
    base_velocity: Array
    base_rpy_reference: Array
    joint_position: Array
    joint_velocity: Array
    com_position: Array
    com_velocity: Array
    com_reference: Array
    rotation_error: Array
    thrust: Array
    thrust_rate: Array
    joint_velocity_command: Array
    joint_torque: Array
    wind: Array
    aero_force_sim: Array
    aero_force_control: Array
    momentum: Array
    momentum_reference: Array
    momentum_rate_estimate: Array
    qp_status: Array
    qp_kkt: Array
    qp_iterations: Array


def prepare(config: FlightConfig, robot: RobotModel, backend: Backend = "tree") -> tuple[Flight, FlightState]:
    """Build a flight and the state in which its first tick finds it. Outside loops: tables and noise are made here.

    Raises
    ------
    ValueError
        Naming what in the configuration does not fit the robot.
    """
    plant, state = world.start_plant(config.simulator, robot, backend)
    controller = control.controller_params(config, robot)
    told = config.controller.wind_estimate
    flight = Flight(
        plant=plant,
        controller=controller,
        wind=config.wind,
        fall=config.simulator.fall,
        believed_robot=believed_robot(config, robot),
        wind_estimate=None if told is None else wind_estimate(told, plant.time_step, _winds(config)),
    )
    ready: tuple[Flight, FlightState] = jax.tree.map(jnp.asarray, (flight, begin(flight, state)))
    return ready


def _winds(config: FlightConfig) -> Array:
    """Wind at every tick of the flight (ticks, 3) [m/s]."""
    times = jnp.arange(config.simulator.n_ticks + 1) * config.simulator.time_step
    winds: Array = jax.jit(jax.vmap(wind_velocity, in_axes=(None, 0)))(config.wind, times)
    return winds


def believed_robot(config: FlightConfig, robot: RobotModel) -> RobotModel | None:
    """Return the controller's model of the robot; `None` if it is the simulated one."""
    error, faults = config.controller.model_error, config.simulator.jet_faults
    believed = robot
    if faults is not None and faults.limit_is_known:
        believed = replace(robot, jets=replace(robot.jets, thrust_max=known_limits(faults, robot)))
    if error is not None:
        masses, inertias = error.mass_scale * robot.masses, error.mass_scale * robot.inertias
        coms = jnp.asarray(robot.coms).at[0].add(error.com_offset)
        believed = replace(believed, masses=masses, coms=coms, inertias=inertias)
    return None if believed is robot else believed


def begin(flight: Flight, plant: PlantState) -> FlightState:
    """Start the controller of a flight whose plant is in this state."""
    robot = flight.plant.robot if flight.believed_robot is None else flight.believed_robot
    return FlightState(
        plant=plant,
        memory=_init(flight.controller, robot, plant.robot),
        told_wind=jnp.zeros_like(plant.robot.velocity[:3]),
        fall=jnp.array(FLYING, jnp.int32),
        fall_error=jnp.zeros_like(plant.robot.velocity[0]),
        fall_tick=jnp.array(-1, jnp.int32),
    )


_init = jax.jit(control.init)


def step(flight: Flight, state: FlightState, tick: Array) -> tuple[FlightState, FlightRow]:
    """Fly one tick, number `tick` (int32), and record it."""
    time = tick * flight.plant.time_step
    wind = wind_velocity(flight.wind, time)
    robot, thrust = state.plant.robot, thrust_feedback(flight.plant.jets, state.plant.jets)
    believed = flight.plant.robot if flight.believed_robot is None else flight.believed_robot
    told = wind if flight.wind_estimate is None else _told_wind(flight, state, tick)
    memory, command, terms = control.tick(flight.controller, believed, state.memory, time, robot, thrust, told)
    seen = _observe(flight, state.plant, terms, wind)

    rotation_error = rotation_angle(multiply(terms.reference.rotation.T, robot.base_rotation))
    com_error = safe_norm(seen.kinematics.com - terms.reference.com_position)
    row = _row(state, time, wind, command, terms, seen, rotation_error)

    fall, error = _judge(flight.fall, robot, rotation_error, com_error)
    lost_now = (state.fall == FLYING) & (fall != FLYING)
    moved = world.advance(flight.plant, state.plant, seen, command.joint_torque, command.thrust_rate, wind)
    goes_on = (state.fall == FLYING) & (fall == FLYING)
    after = FlightState(
        plant=where(goes_on, moved, state.plant),
        memory=where(goes_on, memory, state.memory),
        told_wind=told,
        fall=jnp.where(lost_now, fall, state.fall),
        fall_error=jnp.where(lost_now, error, state.fall_error),
        fall_tick=jnp.where(lost_now, tick.astype(jnp.int32), state.fall_tick),
    )
    return after, row


def _told_wind(flight: Flight, state: FlightState, tick: Array) -> Array:
    assert flight.wind_estimate is not None

    def wind_at(time: Array) -> Array:
        return wind_velocity(flight.wind, time)

    return told_wind(flight.wind_estimate, wind_at, state.told_wind, tick, flight.plant.time_step)


def _observe(flight: Flight, state: PlantState, terms: Terms, wind: Array) -> Observation:
    """Observe the plant; what the controller computed for the same robot is not computed again."""
    plant = flight.plant
    if flight.believed_robot is not None or plant.backend != "tree":
        return world.observe(plant, state, wind)
    return world.observe(plant, state, wind, (terms.kinematics, terms.dynamics))


def _judge(limits: FallConfig, robot: State, rotation_error: Array, com_error: Array) -> tuple[Array, Array]:
    """Whether and why the flight is lost, and by how much."""
    is_finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in (*robot, rotation_error, com_error)]))
    over_rotated = rotation_error > jnp.deg2rad(limits.rotation_error_deg)
    fall = jnp.where(over_rotated, LOST_BY_ROTATION, jnp.where(com_error > limits.com_error, LOST_BY_COM, FLYING))
    fall = jnp.where(is_finite, fall, LOST_NOT_FINITE)
    return fall.astype(jnp.int32), jnp.where(over_rotated, rotation_error, com_error)


def _row(
    state: FlightState,
    time: Array,
    wind: Array,
    command: Command,
    terms: Terms,
    seen: Observation,
    rotation_error: Array,
) -> FlightRow:
    robot, momentum, mass = state.plant.robot, seen.dynamics.momentum, seen.dynamics.mass_matrix[0, 0]
    believed_mass = terms.dynamics.mass_matrix[0, 0]
    answers = (command.momentum_qp, command.torque_qp)
    return FlightRow(
        time=time,
        base_position=robot.base_position,
        base_quaternion=wxyz_from_rotation(robot.base_rotation),
        base_velocity=robot.velocity[:6],
        base_rpy_reference=rpy_from_rotation(terms.reference.rotation),
        joint_position=robot.joint_position,
        joint_velocity=robot.velocity[6:],
        com_position=seen.kinematics.com,
        com_velocity=momentum[:3] / mass,
        com_reference=terms.reference.com_position,
        rotation_error=rotation_error,
        thrust=state.plant.jets.thrust,
        thrust_rate=command.thrust_rate,
        joint_velocity_command=command.joint_velocity,
        joint_torque=command.joint_torque,
        wind=wind,
        aero_force_sim=seen.link_forces.forces,
        aero_force_control=terms.link_forces.forces,
        momentum=momentum,
        momentum_reference=jnp.concatenate([believed_mass * terms.reference.com_velocity, jnp.zeros_like(wind)]),
        momentum_rate_estimate=terms.momentum.rate_estimate,
        qp_status=jnp.stack([answer.status for answer in answers]),
        qp_kkt=jnp.stack([answer.kkt for answer in answers]),
        qp_iterations=jnp.stack([answer.iterations for answer in answers]),
    )
