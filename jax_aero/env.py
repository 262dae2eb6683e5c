"""The flight as a reinforcement-learning environment of pure functions, which MuJoCo Playground's wrappers train.

Examples
--------
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
the same task for Gymnasium, based on the crate, whose channels and fault detection also act: `robot` holds a measured
wind that jumps, here it does not.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jax_aero import env_task
from jax_aero.base.features import Aim, aim_of
from jax_aero.base.twin import Float, Int, Key, jax, jnp
from jax_aero.body.kinematics import kinematics
from jax_aero.body.spatial import rotation_angle
from jax_aero.control.law.residual import Steering
from jax_aero.control.law.setpoint import update
from jax_aero.control.tick import MomentumController
from jax_aero.env_task import FEATURES, Observation, Reward, Task, TaskState
from jax_aero.rust import load_config
from jax_aero.sim.outcome import FLYING
from jax_aero.sim.preparation import prepare
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.step import FlightState, begin, step
from jax_aero.types import Array, replace_values

__all__ = ["EnvState", "FlightEnv", "Task"]


class Episode(NamedTuple):
    """All that an episode goes on from, which a wrapper for restarts puts back as a whole."""

    flight: FlightState
    tick: Int[Array, ""]
    """Number of the next tick."""
    wind: Float[Array, "3"]
    """Of this episode, at its strongest [m/s]."""
    phases: Float[Array, "..."]
    """Phases of its turbulence [rad]; none in a wind without."""
    drawn: Int[Array, ""]
    """Number of the configuration that is flown."""


class EnvState(NamedTuple):
    """State of the environment between two steps."""

    data: Episode
    obs: Float[Array, " o"]
    reward: Float[Array, ""]
    done: Float[Array, ""]
    """1 if the robot is lost."""
    metrics: dict[str, Float[Array, ""]]
    """Parts of the reward, and the errors of attitude [rad] and position [m] from the set-point; zero if the robot is
    lost."""
    info: dict[str, Any]
    """The wind of the episode [m/s], and what wrappers add."""

    def replace(self, **changes: Any) -> EnvState:
        """Return a state with other entries."""
        return self._replace(**changes)


class _Drawn(NamedTuple):
    """A configuration, ready for its episodes."""

    scenario: Scenario
    start: FlightState
    first: Aim


class FlightEnv:
    """Fly a task in a wind drawn anew for every episode; `reset` and `step` are pure, for `jit` and `vmap`.

    Parameters
    ----------
    task
        The task to learn, or the name of an experiment to learn to hover in.
    drawn
        Configurations of which every episode draws one, in place of the task's experiment: with other masses, latencies
        or sensors, by hand or by the perturbations of a sweep. They have the same switches and differ in numbers.
    observation
        What an agent observes: names of features, or a function (`env_task.Observation`).
    reward
        Function of the parts of a tick's reward (`env_task.Reward`).

    Raises
    ------
    ValueError
        For a task or an observation that is none, a configuration that JAX does not fly, and drawn ones of different
        structure.
    """

    jets: int
    action_size: int
    observation_size: int
    dt: float
    """[s]."""
    episode_length: int
    """[ticks]."""

    def __init__(
        self,
        task: Task | str | None = None,
        drawn: Sequence[Mapping[str, Any]] = (),
        observation: Observation = FEATURES,
        reward: Reward = env_task.rewards,
    ) -> None:
        self.task, self.observation, self._reward = env_task.task_of(task), observation, reward
        env_task.check_observation(observation)
        precision = np.dtype(jnp.result_type(float))
        configs = list(drawn) or [load_config(self.task.experiment)]
        ready = [self._prepare(config, precision) for config in configs]
        numbers, structures = zip(*map(jax.tree.flatten, ready), strict=True)
        shapes = [(structure, [*map(jnp.shape, of)]) for structure, of in zip(structures, numbers, strict=True)]
        for number, shape in enumerate(shapes):
            if shape != shapes[0]:
                raise ValueError(
                    f"`drawn[{number}]` differs from `drawn[0]` in more than numbers; expected the same switches"
                )
        self._count, self._drawn = len(ready), ready[0]
        # What is alike in all of them is kept once: a batch of flights computes with it as a constant.
        self._varied = {
            place: jnp.stack(leaves)
            for place, leaves in enumerate(zip(*numbers, strict=True))
            if not all(np.array_equal(leaf, leaves[0]) for leaf in leaves)
        }
        robot, plant = ready[0].scenario.plant.robot, ready[0].scenario.plant
        self.jets = robot.jets.count
        self.action_size = self.jets + robot.n_joints
        self.dt = float(plant.time_step)
        self.episode_length = self.task.ticks(self.dt)
        self._winds, self._values = (self.task.wind_min, self.task.wind_max), dict[str, Any]()
        first = self._episode(jnp.zeros(3), 0)
        state, obs = jax.eval_shape(lambda: self._observe(first))
        self.observation_size = obs.shape[0]
        action = jnp.zeros(self.action_size, obs.dtype)
        self._parts = tuple(jax.eval_shape(lambda *of: dict(reward(jnp, *of)), state, action))

    @property
    def unwrapped(self) -> FlightEnv:
        """Return this environment, which wraps no other."""
        return self

    def at(self, *, wind_max: Any = None, wind_min: Any = None, values: Mapping[str, Any] | None = None) -> FlightEnv:
        """Return this environment with other winds [m/s], or other numbers of its scenario: a step of a curriculum.

        They may be traced. `values` are by names of `replace_values`, such as `plant.force_scale`; they hold from the
        next tick on, also in episodes that have begun.
        """
        other = copy.copy(self)
        least, most = self._winds
        other._winds = (least if wind_min is None else wind_min, most if wind_max is None else wind_max)
        other._values = self._values | dict(values or {})
        return other

    def reset(self, key: Key[Array, ""]) -> EnvState:
        """Begin an episode in a random wind, with one of the drawn configurations."""
        number = jax.random.randint(jax.random.fold_in(key, 2), (), 0, self._count)
        return self._begin(self._episode(self.draw_wind(key), number, jax.random.fold_in(key, 3)))

    def draw_wind(self, key: Key[Array, ""]) -> Float[Array, "3"]:
        """Return a wind [m/s] of any horizontal direction; all speeds are equally likely."""
        speed_key, direction_key = jax.random.split(key)
        dtype = self._drawn.start.plant.robot.velocity.dtype
        speed = jax.random.uniform(speed_key, (), dtype, *self._winds)
        angle = jax.random.uniform(direction_key, (), dtype, 0.0, 2.0 * jnp.pi)
        return speed * jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)])

    def start(self, wind: Float[Array, "3"], drawn: Int[Array, ""] | int = 0) -> EnvState:
        """Begin an episode in a given wind [m/s], with the drawn configuration of this number."""
        return self._begin(self._episode(wind, drawn))

    def _episode(self, wind: Any, drawn: Any, key: Any = None) -> Episode:
        number = jnp.asarray(drawn, jnp.int32)
        of = self._pick(number)
        wind = jnp.asarray(wind, of.start.plant.robot.velocity.dtype)
        phases = getattr(of.scenario.wind, "phases", jnp.zeros(0, wind.dtype))
        if key is not None:
            phases = jax.random.uniform(key, phases.shape, wind.dtype, 0.0, 2.0 * jnp.pi)
        return Episode(of.start, jnp.zeros((), jnp.int32), wind, jnp.asarray(phases), number)

    def _begin(self, episode: Episode) -> EnvState:
        zero = jnp.zeros((), episode.wind.dtype)
        names = (*self._parts, "attitude_error", "position_error")
        return EnvState(
            data=episode,
            obs=self._observe(episode)[1],
            reward=zero,
            done=zero,
            metrics=dict.fromkeys(names, zero),
            info={"wind": episode.wind},
        )

    @jax.default_matmul_precision("highest")  # type: ignore[untyped-decorator]
    def step(self, state: EnvState, action: Float[Array, " u"]) -> EnvState:
        """Fly one tick with an action between −1 and 1."""
        episode = state.data
        action = env_task.limit_action(jnp, action, (self.action_size,), episode.wind.dtype)
        drawn = self._pick(episode.drawn).scenario
        scenario: Scenario = replace_values(drawn, self._wind(episode))
        scenario = replace(scenario, controller=self._steered(drawn, action))
        flight, _ = step(scenario, episode.flight, episode.tick)
        episode = episode._replace(flight=flight, tick=episode.tick + 1)
        task_state, obs = self._observe(episode)
        parts = self._reward(jnp, task_state, action)
        is_no_number = ~jnp.all(jnp.isfinite(action))
        lost = (flight.loss != FLYING) | env_task.is_lost(jnp, task_state, scenario.fall) | is_no_number
        errors = {
            "attitude_error": rotation_angle(task_state.aim.rotation.T @ task_state.rotation),
            "position_error": jnp.linalg.norm(task_state.com - task_state.aim.com),
        }
        # The numbers of a lost robot need not be finite.
        metrics = {
            name: jnp.where(lost, 0.0, value).astype(state.reward.dtype) for name, value in {**parts, **errors}.items()
        }
        return EnvState(
            data=episode,
            obs=jnp.where(jnp.isfinite(obs), obs, 0.0),
            reward=sum((metrics[name] for name in parts), jnp.zeros_like(state.reward)),
            done=lost.astype(state.done.dtype),
            metrics=state.metrics | metrics,  # wrappers add to both
            info=dict(state.info),
        )

    def _prepare(self, config: Mapping[str, Any], precision: Any) -> _Drawn:
        scenario, start = prepare(self.task.episode(config), dtype=precision)
        robot, first = scenario.plant.robot, start.plant.robot
        size = robot.jets.count + robot.n_joints
        steered = replace(scenario, controller=self._steered(scenario, jnp.zeros(size, precision)))
        aim = self.task.aim(jnp, kinematics(robot, first).com, first.base_rotation)
        return _Drawn(scenario, begin(steered, start.plant), aim)

    def _pick(self, number: Int[Array, ""]) -> _Drawn:
        """Return the drawn configuration of this number."""
        leaves, structure = jax.tree.flatten(self._drawn)
        chosen = [self._varied[place][number] if place in self._varied else leaf for place, leaf in enumerate(leaves)]
        drawn: _Drawn = jax.tree.unflatten(structure, chosen)
        return drawn._replace(scenario=replace_values(drawn.scenario, self._values))

    def _wind(self, episode: Episode) -> dict[str, Array]:
        """Return the wind of an episode, by names of `replace_values`."""
        wind = {f"wind.{key}": value for key, value in self.task.wind(jnp, episode.wind).items()}
        if self.task.profile != "turbulent":
            return wind
        return {"wind.mean.velocity": wind.pop("wind.velocity"), "wind.phases": episode.phases, **wind}

    def _steered(self, scenario: Scenario, action: Float[Array, " u"]) -> MomentumController:
        """Return the controller with an action as its residual."""
        controller, jets = scenario.controller, scenario.plant.robot.jets.count
        assert isinstance(controller, MomentumController)
        residual = Steering(*env_task.steer(self.task, action, jets), self.task.steering == "rates")
        return replace(controller, residual=residual)

    def _aim(self, drawn: _Drawn, episode: Episode) -> Aim:
        """Return what the next tick follows."""
        if not self.task.tracking:
            return drawn.first
        controller, memory = drawn.scenario.controller, episode.flight.controller
        assert isinstance(controller, MomentumController)
        time = episode.tick.astype(episode.wind.dtype) * drawn.scenario.plant.time_step
        return aim_of(update(controller.setpoint, controller.mission, memory.setpoint, time)[1])

    @jax.default_matmul_precision("highest")  # type: ignore[untyped-decorator]
    def _observe(self, episode: Episode) -> tuple[TaskState, Array]:
        drawn, now = self._pick(episode.drawn), episode.flight.plant
        plant = drawn.scenario.plant
        task_state = TaskState(
            rotation=now.robot.base_rotation,
            velocity=now.robot.velocity,
            joint_position=now.robot.joint_position,
            thrust=plant.jets.feedback(now.jets),
            com=kinematics(plant.robot, now.robot).com,
            aim=self._aim(drawn, episode),
            posture=drawn.start.plant.robot.joint_position,
            wrench=episode.flight.controller.residual.wrench,
            thrust_max=jnp.asarray(plant.robot.jets.thrust_max, episode.wind.dtype),
        )
        obs: Array = env_task.observe(jnp, self.observation, task_state)
        return task_state, obs
