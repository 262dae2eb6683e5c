"""The flight as a reinforcement-learning environment of pure functions, with the interface of MuJoCo Playground.

>>> import jax
>>> from jax_aero import env
>>> hover = env.FlightEnv()
>>> states = jax.jit(jax.vmap(hover.reset))(jax.random.split(jax.random.key(0), 8))
>>> states = jax.jit(jax.vmap(hover.step))(states, jax.numpy.zeros((8, hover.action_size)))
>>> states.obs.shape, states.reward.shape
((8, 71), (8,))

An action has one number between −1 and 1 for each jet and joint. It is a residual on the controller's thrust rates and
joint velocities, or replaces them (`env_task.Task.steering`). An episode ends when the robot is lost; the trainer
decides on its greatest length, for which `episode_length` gives the task's own, and on restarts. `jax_aero.env_gym` is
the same task for Gymnasium, based on the crate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from jax_aero.base.features import Aim, aim_of
from jax_aero.body.kinematics import kinematics
from jax_aero.body.spatial import rotation_angle
from jax_aero.control.law.residual import Steering
from jax_aero.control.law.setpoint import update
from jax_aero.control.tick import MomentumController
from jax_aero.env_task import Task, TaskState, is_lost, limit_action, observation, rewards, steer
from jax_aero.rust import load_config
from jax_aero.sim.outcome import FLYING
from jax_aero.sim.prepare import prepare
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.step import FlightState, begin, step
from jax_aero.types import Array, replace_values

__all__ = ["EnvState", "FlightEnv", "Task"]


class EnvState(NamedTuple):
    """State of the environment between two steps."""

    flight: FlightState
    tick: Int[Array, ""]
    """Number of the next tick."""
    wind: Float[Array, "3"]
    """Of this episode, at its strongest [m/s]."""
    obs: Float[Array, " o"]
    reward: Float[Array, ""]
    done: Float[Array, ""]
    """1 if the robot is lost."""
    metrics: dict[str, Float[Array, ""]]
    """Parts of the reward, and the errors of attitude [rad] and position [m]; zero if the robot is lost."""
    info: dict[str, Any]
    """For wrappers; not changed here."""


class FlightEnv:
    """Fly a task in a wind drawn anew for every episode; `reset` and `step` are pure, for `jit` and `vmap`.

    Parameters
    ----------
    task
        The task to learn.
    changes
        Changes of the configuration by dotted key, as in `load_config`.
    dtype
        Precision of the simulation; by default that of JAX (`jax.enable_x64`).
    """

    def __init__(self, task: Task | None = None, changes: Mapping[str, Any] | None = None, dtype: Any = None) -> None:
        self.task = task or Task()
        precision = np.dtype(jnp.result_type(float)) if dtype is None else np.dtype(dtype)
        self._scenario, self._start = prepare(
            self.task.episode(load_config(self.task.experiment, changes)), dtype=precision
        )
        robot, first = self._scenario.plant.robot, self._start.plant.robot
        self.action_size = robot.jets.count + robot.n_joints
        steered = replace(self._scenario, controller=self._steered(jnp.zeros(self.action_size, precision)))
        self._start = begin(steered, self._start.plant)
        still = jnp.zeros_like(first.velocity[:3])
        self._first = Aim(kinematics(robot, first).com, first.base_rotation, still, still)
        self.observation_size = 21 + 2 * robot.n_joints + robot.jets.count
        self.dt = float(self._scenario.plant.time_step)
        self.episode_length = self.task.ticks(self.dt)

    def reset(self, key: Key[Array, ""]) -> EnvState:
        """Begin an episode in a random wind."""
        speed_key, direction_key = jax.random.split(key)
        dtype = self._start.plant.robot.velocity.dtype
        speed = jax.random.uniform(speed_key, (), dtype, self.task.wind_min, self.task.wind_max)
        angle = jax.random.uniform(direction_key, (), dtype, 0.0, 2.0 * jnp.pi)
        wind = speed * jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)])
        return self.start(wind)

    def start(self, wind: Float[Array, "3"]) -> EnvState:
        """Begin an episode in a given wind [m/s]."""
        flight = self._start
        robot = flight.plant.robot
        wind = jnp.asarray(wind, robot.velocity.dtype)
        zero = jnp.zeros((), robot.velocity.dtype)
        names = ("attitude", "position", "effort", "attitude_error", "position_error")
        state = EnvState(
            flight=flight,
            tick=jnp.zeros((), jnp.int32),
            wind=wind,
            obs=jnp.zeros(self.observation_size, zero.dtype),
            reward=zero,
            done=zero,
            metrics=dict.fromkeys(names, zero),
            info={},
        )
        return state._replace(obs=self._observe(state)[1])

    def step(self, state: EnvState, action: Float[Array, " u"]) -> EnvState:
        """Fly one tick with an action between −1 and 1."""
        action = limit_action(jnp, action, self.action_size, state.wind.dtype)
        scenario: Scenario = replace_values(self._scenario, {f"wind.{self.task.wind_key}": state.wind})
        scenario = replace(scenario, controller=self._steered(action))
        flight, _ = step(scenario, state.flight, state.tick)
        state = state._replace(flight=flight, tick=state.tick + 1)
        task_state, obs = self._observe(state)
        parts = rewards(jnp, task_state, action)
        is_no_number = ~jnp.all(jnp.isfinite(action))
        lost = (flight.loss != FLYING) | is_lost(jnp, task_state, scenario.fall) | is_no_number
        errors = {
            "attitude_error": rotation_angle(task_state.aim.rotation.T @ task_state.rotation),
            "position_error": jnp.linalg.norm(task_state.com - task_state.aim.com),
        }
        # The numbers of a lost robot need not be finite.
        metrics = {
            name: jnp.where(lost, 0.0, value).astype(state.reward.dtype) for name, value in (parts | errors).items()
        }
        return state._replace(
            obs=jnp.where(jnp.isfinite(obs), obs, 0.0),
            reward=sum((metrics[name] for name in parts), jnp.zeros_like(state.reward)),
            done=lost.astype(state.done.dtype),
            metrics=metrics,
        )

    def _steered(self, action: Float[Array, " u"]) -> MomentumController:
        """Return the controller with an action as its residual."""
        controller, jets = self._scenario.controller, self._scenario.plant.robot.jets.count
        assert isinstance(controller, MomentumController)
        residual = Steering(*steer(self.task, action, jets), self.task.steering == "rates")
        return replace(controller, residual=residual)

    def _aim(self, state: EnvState) -> Aim:
        """Return what the next tick follows."""
        if not self.task.tracking:
            return self._first
        controller, memory = self._scenario.controller, state.flight.controller
        assert isinstance(controller, MomentumController)
        time = state.tick.astype(state.wind.dtype) * self._scenario.plant.time_step
        return aim_of(update(controller.setpoint, controller.mission, memory.setpoint, time)[1])

    def _observe(self, state: EnvState) -> tuple[TaskState, Array]:
        robot, now, first = self._scenario.plant.robot, state.flight.plant, self._start.plant.robot
        task_state = TaskState(
            rotation=now.robot.base_rotation,
            velocity=now.robot.velocity,
            joint_position=now.robot.joint_position,
            thrust=self._scenario.plant.jets.feedback(now.jets),
            com=kinematics(robot, now.robot).com,
            aim=self._aim(state),
            posture=first.joint_position,
            wrench=state.flight.controller.residual.wrench,
        )
        obs: Array = observation(jnp, task_state, robot.jets.thrust_max)
        return task_state, obs
