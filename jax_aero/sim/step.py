"""One tick of the closed-loop flight: the order of computation of plant and controller.

At tick k, t = k h:

    observe   kinematics and aerodynamic forces at x_k in the wind of t
    control   thrust rates and torques from (x_k, T_k, wind), held until the next tick
    record    and stop if the flight is lost
    advance   x_{k+1} from x_k, T_k and the torques;  T_{k+1} = T_k + h Ṫ*

as in the Rust crate. A lost flight keeps the state in which it was lost: its status is permanent and later rows repeat.

Equations M77 and M80 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from jax_aero.body.spatial import multiply, rotation_angle, safe_norm
from jax_aero.control import Command, Measurement
from jax_aero.sim import outcome
from jax_aero.sim import plant as world
from jax_aero.sim.actuation import ActuationState
from jax_aero.sim.measuring import MeasuringState
from jax_aero.sim.outcome import FLYING
from jax_aero.sim.plant import Acting, Observation, PlantState
from jax_aero.sim.scenario import Scenario, check_precision
from jax_aero.sim.signals import FlightRow, record, record_divergence
from jax_aero.sim.wind import wind_velocity
from jax_aero.types import Array, where


class FlightState(NamedTuple):
    """State of a flight between two ticks."""

    plant: PlantState
    controller: Any
    """State of the controller."""
    measuring: MeasuringState
    actuation: ActuationState | None
    posture: Float[Array, " n"]
    """Joint positions measured at the first tick [rad]."""
    loss: Int[Array, ""]
    """`FLYING`, or the criterion by which the flight was lost."""
    loss_size: Float[Array, ""]
    """Error of a fall, in the criterion's unit."""
    loss_tick: Int[Array, ""]
    """Tick at which the flight was lost, −1 while it flies."""


@jax.jit
def begin(scenario: Scenario, plant: PlantState) -> FlightState:
    """Start the controller for a plant in this state."""
    # A state beyond the divergence limits is lost at once, and must not make derivatives infinite before that.
    divergence = outcome.divergence(scenario.plant, plant, jnp.zeros_like(plant.robot.velocity[:3]))
    first = where(divergence == FLYING, plant, world.zero_state(plant))
    still = jnp.zeros_like(plant.robot.velocity[:3])
    true = _truth(scenario, first, jnp.zeros_like(still[0]), still)
    measuring = scenario.measuring.start(true)
    seen = _measure(scenario, measuring, true, jnp.array(0, jnp.int32))[1]
    return FlightState(
        plant=plant,
        controller=scenario.controller.init(scenario.model, seen.state),
        measuring=measuring,
        actuation=None if scenario.actuation is None else scenario.actuation.start(true),
        posture=seen.state.joint_position,
        loss=jnp.array(FLYING, jnp.int32),
        loss_size=jnp.zeros_like(plant.robot.velocity[0]),
        loss_tick=jnp.array(-1, jnp.int32),
    )


def step(
    scenario: Scenario,
    state: FlightState,
    tick: Int[Array, ""],
    hand: Callable[[Measurement], Measurement] = lambda measured: measured,
) -> tuple[FlightState, FlightRow]:
    """Fly one tick, number `tick`, and record it; `hand` returns what the controller is given for a measurement.

    Raises
    ------
    ValueError
        When traced in another precision than the scenario was prepared for; for a command, or forces of an aerodynamic
        model, of another shape than the robot's.
    """
    check_precision(scenario)
    with jax.default_matmul_precision("highest"):  # a GPU rounds factors to ten bits otherwise
        return _fly(scenario, state, jnp.asarray(tick, jnp.int32), hand)


def _fly(
    scenario: Scenario, state: FlightState, tick: Array, hand: Callable[[Measurement], Measurement]
) -> tuple[FlightState, FlightRow]:
    plant = scenario.plant
    time = tick.astype(plant.time_step.dtype) * plant.time_step
    wind = wind_velocity(scenario.wind, time)
    # Both branches of `where` are differentiated, so values beyond the limits must not enter the computation.
    divergence = outcome.divergence(plant, state.plant, wind)
    is_sound = divergence == FLYING
    at_rest = world.zero_state(state.plant)
    now, air = where(is_sound, (state.plant, wind), (at_rest, jnp.zeros_like(wind)))

    measuring, measurement = _measure(scenario, state.measuring, _truth(scenario, now, time, air), tick)
    memory, command = scenario.controller.step(scenario.model, state.controller, hand(measurement))
    command.check(plant.robot)
    seen = _observe(scenario, now, command, air)

    rotation_error, fall, error = _errors(scenario, now, seen, command)
    row = record(time, wind, now, seen, measurement, command, rotation_error)
    row = where(is_sound, row, record_divergence(time, wind, state.plant, row))

    loss = jnp.where(is_sound, fall, divergence)
    lost_now = (state.loss == FLYING) & (loss != FLYING)
    goes_on = (state.loss == FLYING) & (loss == FLYING)
    # The next step of a lost flight may overflow.
    torques = jnp.broadcast_to(command.joint_torque, (plant.substeps, *command.joint_torque.shape))
    acting, actuation = Acting(command.thrust_rate, torques), state.actuation
    if scenario.actuation is not None and actuation is not None:
        actuation, acting = scenario.actuation.act(actuation, acting)
    moved = world.advance(plant, where(goes_on, now, at_rest), seen, acting, air)
    after = FlightState(
        plant=where(goes_on, moved, state.plant),
        controller=where(goes_on, memory, state.controller),
        measuring=measuring,
        actuation=actuation,
        posture=state.posture,
        loss=jnp.where(lost_now, loss, state.loss),
        loss_size=jnp.where(lost_now, error, state.loss_size),
        loss_tick=jnp.where(lost_now, tick, state.loss_tick),
    )
    return after, row


def _truth(scenario: Scenario, now: PlantState, time: Array, wind: Array) -> Measurement:
    """Return what a controller measures of this plant in this wind without sensors."""
    return Measurement(time, now.robot, scenario.plant.jets.feedback(now.jets), wind)


def _measure(
    scenario: Scenario, state: MeasuringState, true: Measurement, tick: Array
) -> tuple[MeasuringState, Measurement]:
    """Return the next state of what measures, and the measurement."""
    return scenario.measuring.measure(state, true, tick, scenario.wind, scenario.plant.time_step)


def _errors(
    scenario: Scenario, now: PlantState, seen: Observation, command: Command
) -> tuple[Array | None, Array, Array]:
    """Return the rotation error [rad], whether and why the robot has fallen, and the error of the fall."""
    if command.setpoint is None:
        return None, jnp.array(FLYING, jnp.int32), jnp.zeros_like(scenario.plant.time_step)
    rotation_error = rotation_angle(multiply(command.setpoint.rotation.T, now.robot.base_rotation))
    com_error = safe_norm(seen.kinematics.com - command.setpoint.com_position)
    return rotation_error, *outcome.fall(scenario.fall, rotation_error, com_error)


def _observe(scenario: Scenario, state: PlantState, command: Command, wind: Array) -> Observation:
    """Observe the plant; reuse what the controller computed for the same robot in the same state."""
    plant, terms = scenario.plant, command.terms
    # With sensors or an estimator, also within a wrapped controller, the state is another object.
    is_known = terms is not None and terms.estimates.state is state.robot and scenario.controller_model is None
    if terms is None or not is_known or plant.backend != "tree":
        return world.observe(plant, state, wind)
    return world.observe(plant, state, wind, (terms.kinematics, terms.dynamics, terms.inverse_mass))
