"""Identification of aerodynamic coefficients from a flight's log, by gradients through the simulation.

Starting at many logged states, a few ticks are simulated under the logged commands. `misfit_of` compares the final
velocities with the logged ones, and `descend` minimises the misfit over relative changes θ of the force areas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero.aero import Axisymmetric, LinkConventions, link_forces, wrench_about
from jax_aero.body.jets import JetsState
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotation_from_wxyz
from jax_aero.sim.plant import Acting, Plant, PlantState, advance, observe
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.types import Array, State


class Segments(NamedTuple):
    """Logged states with the commands that followed them; k segments of h ticks."""

    first: State
    thrust: Float[Array, "k j"]
    """Thrusts at the start [N]."""
    torque: Float[Array, "k h n"]
    """Joint torques [N m]."""
    thrust_rate: Float[Array, "k h j"]
    """Thrust rates [N/s]."""
    wind: Float[Array, "k h 3"]
    """Wind [m/s, inertial axes]."""
    velocity: Float[Array, "k N"]
    """Logged velocity ν after the h ticks [m/s, rad/s]."""


def segments_of(
    log: Mapping[str, Float[np.ndarray, "ticks ..."]], first_tick: int, count: int, horizon: int
) -> Segments:
    """Return `count` segments of `horizon` ticks of a log, evenly spaced from `first_tick` to its end."""
    starts = np.linspace(first_tick, len(log["time"]) - horizon - 1, count, dtype=int)
    ticks = starts[:, None] + np.arange(horizon)
    return Segments(
        first=states_of(log, starts),
        thrust=jnp.asarray(log["thrust"][starts]),
        torque=jnp.asarray(log["joint_torque"][ticks]),
        thrust_rate=jnp.asarray(log["thrust_rate"][ticks]),
        wind=jnp.asarray(log["wind"][ticks]),
        velocity=states_of(log, starts + horizon).velocity,
    )


def states_of(log: Mapping[str, Float[np.ndarray, "ticks ..."]], ticks: Any) -> State:
    """Return the states of a log at the given ticks."""
    velocity = np.concatenate([log["base_velocity"][ticks], log["joint_velocity"][ticks]], axis=1)
    return State(
        base_position=jnp.asarray(log["base_position"][ticks]),
        base_rotation=rotation_from_wxyz(jnp.asarray(log["base_quaternion"][ticks])),
        joint_position=jnp.asarray(log["joint_position"][ticks]),
        velocity=jnp.asarray(velocity),
    )


def simulated_velocity(plant: Plant, segment: Segments) -> Float[Array, " N"]:
    """Return the velocity ν after one segment, simulated from its first state under its commands."""
    jets = JetsState(segment.thrust, jnp.zeros_like(segment.thrust), None)

    def tick(state: PlantState, commands: tuple[Array, Array, Array]) -> tuple[PlantState, None]:
        torque, thrust_rate, wind = commands
        acting = Acting(thrust_rate, (torque,) * plant.substeps)
        return advance(plant, state, observe(plant, state, wind), acting, wind), None

    start = PlantState(segment.first, jets, None)
    end, _ = jax.lax.scan(jax.checkpoint(tick), start, (segment.torque, segment.thrust_rate, segment.wind))
    return end.robot.velocity


def misfit_of(
    plant: Plant,
    model: Axisymmetric,
    segments: Segments,
    member: Int[np.ndarray, " L"],
    deviation: Float[np.ndarray, " N"],
    spread: float,
) -> Callable[[Float[Array, "families 6"]], Float[Array, ""]]:
    """Return the loss per logged velocity as a function of `θ`.

        ( Σ ((ν_simulated − ν_logged)/σ)² + Σ (θ/spread)² ) / (2 k N)      areas = (1 + θ[member]) · those of `model`

    `deviation` is σ [m/s, rad/s] of the logged velocities, `member` the family of each link.
    """

    def misfit(theta: Array) -> Array:
        guess = replace(plant, aero=replace(model, areas=model.areas * (1.0 + theta[member])))
        end = jax.vmap(lambda segment: simulated_velocity(guess, segment))(segments)
        wrong = jnp.sum(((end - segments.velocity) / deviation) ** 2)
        return 0.5 * (wrong + jnp.sum((theta / spread) ** 2)) / segments.velocity.size

    return misfit


def descend(
    misfit: Callable[[Float[Array, "families 6"]], Float[Array, ""]],
    exists: Bool[np.ndarray, "families 6"],
    steps: int,
    rate: float,
) -> tuple[Float[np.ndarray, "families 6"], Float[np.ndarray, " steps"]]:
    """Minimise by Adam from θ = 0, over the entries where `exists`; return `θ` and the loss before each step."""

    @jax.jit
    def step(adam: AdamState, theta: Array) -> tuple[AdamState, Array, Array]:
        value, slope = jax.value_and_grad(misfit)(theta)
        decayed = rate * 0.5 * (1.0 + jnp.cos(jnp.pi * (adam.count + 1) / steps))
        return *adam_step(adam, theta, slope * exists, decayed, beta2=0.99, epsilon=1e-12), value

    theta = jnp.zeros(exists.shape)
    adam, losses = adam_start(theta), []
    for _ in range(steps):
        adam, theta, value = step(adam, theta)
        losses.append(float(value))
    return np.asarray(theta), np.array(losses)


def wrenches_along(
    log: Mapping[str, Float[np.ndarray, "ticks ..."]], robot: RobotModel, models: Mapping[str, Axisymmetric]
) -> dict[str, Float[np.ndarray, "ticks 6"]]:
    """Return each model's total force and moment about the centre of mass [N, N m] along a log, inertial axes."""

    @jax.jit
    def evaluate(model: Axisymmetric) -> Array:
        def wrench_in_wind(state: State, wind: Array) -> Array:
            kin = kinematics(robot, state)
            return wrench_about(link_forces(model, robot, kin, LinkConventions(), wind), kin.com)

        return jax.vmap(wrench_in_wind)(states_of(log, slice(None)), jnp.asarray(log["wind"]))

    return {name: np.asarray(evaluate(model)) for name, model in models.items()}
