"""The flight as a Gymnasium environment, alone or many at once: `rust.Flight` with actions as residuals, without JAX.

Examples
--------
>>> from jax_aero.env_gym import HoverEnv
>>> hover = HoverEnv()
>>> obs, info = hover.reset(seed=0)
>>> obs, reward, terminated, truncated, info = hover.step(hover.action_space.sample())

Needs the extra `rl`. Task, observation and reward are those of `jax_aero.env`. Once this module is imported,
`gymnasium.make` and `make_vec` have it as `jax_aero/Hover-v0`; `jax_aero.env_gym:jax_aero/Hover-v0` imports it.
Sensors, outages and faults of the experiment act on the controller; what is observed is the true state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import index
from types import SimpleNamespace
from typing import Any, Literal, SupportsIndex, cast

import gymnasium  # type: ignore[import-not-found,unused-ignore]
import numpy as np
from gymnasium.vector.utils import batch_space  # type: ignore[import-not-found,unused-ignore]
from numpy.typing import NDArray

from jax_aero import env_task, rust
from jax_aero.base.features import Aim
from jax_aero.env_task import FEATURES, Observation, Reward, Task, TaskState

__all__ = ["HoverEnv", "HoverVectorEnv"]

LARGEST = 1e6
"""Bound that no observation reaches before the flight counts as lost."""

OF_THE_CRATE = {"_robot", "_flight"}
"""Attributes that cannot be copied: they are made anew."""


class HoverEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Fly a task in a wind drawn anew for every episode; actions as in `jax_aero.env.FlightEnv`.

    A copy, also by `pickle`, flies the episode up to the present tick again.

    Parameters
    ----------
    task
        The task to learn, or the name of an experiment to learn to hover in.
    drawn
        Configurations of one robot of which every episode draws one, in place of the task's experiment: with other
        masses, latencies, sensors or faults, by hand or by the perturbations of a sweep.
    observation, reward
        As of `jax_aero.env.FlightEnv`, with `numpy` and leading axes of several robots.
    render_mode
        "rgb_array" for pictures by `render`, which need the extra `view`.
    """

    _robot: rust.Robot
    _flight: rust.Flight
    _first: Aim
    metadata = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        task: Task | str | None = None,
        drawn: Sequence[Mapping[str, Any]] = (),
        render_mode: Literal["rgb_array"] | None = None,
        observation: Observation = FEATURES,
        reward: Reward = env_task.rewards,
    ) -> None:
        self.task, self.render_mode = env_task.task_of(task), render_mode
        self._observation, self._reward = observation, reward
        env_task.check_observation(observation)
        configs = list(drawn) or [rust.load_config(self.task.experiment)]
        self._drawn = [self.task.episode(config) for config in configs]
        self._config = self._drawn[0]
        self._fall = SimpleNamespace(**self._config["simulator"]["fall"])
        self._robot = rust.Robot(self._config["robot"])
        self._thrust_max = np.array(self._robot.thrust_max)
        n, j = len(self._robot.joint_names), len(self._robot.jet_names)
        self._size = j + n
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self._size,), np.float32)
        self.dt = float(self._config["controller"]["time_step"])
        self._last_tick = self.task.ticks(self.dt)
        self._seed: int | None = None
        self._begin([0.0, 0.0, 0.0])
        self.observation_space = gymnasium.spaces.Box(-LARGEST, LARGEST, _observe([self])[1].shape[1:], np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode in the wind `options["wind"]` (3,) [m/s], or in a random one if it is not given."""
        super().reset(seed=seed)
        options = options or {}
        if unknown := options.keys() - {"wind"}:
            raise ValueError(f"options of `reset` are {', '.join(sorted(unknown))}; expected `wind`, or none")
        speed = self.np_random.uniform(self.task.wind_min, self.task.wind_max)
        angle = self.np_random.uniform(0.0, 2.0 * np.pi)
        drawn = [speed * np.cos(angle), speed * np.sin(angle), 0.0]
        if self.task.profile == "turbulent":
            self._seed = int(self.np_random.integers(2**31))
        if len(self._drawn) > 1:
            self._config = self._drawn[self.np_random.integers(len(self._drawn))]
        self._begin([float(part) for part in options.get("wind", drawn)])
        return _observe([self])[1][0], {"wind": np.array(self._wind)}

    def step(self, action: NDArray[np.floating]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Fly one tick."""
        clipped = env_task.limit_action(np, action, (self._size,), np.float64)
        obs, lost, ended, parts = _step([self], clipped[None])
        terms = {name: float(values[0]) for name, values in parts.items()}
        return obs[0], 0.0 if lost[0] else sum(terms.values()), bool(lost[0]), bool(ended[0]), terms

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override,unused-ignore]
        """Return the picture of the latest tick, before any of the first one: (480, 640, 3)."""
        if self.render_mode is None:
            return None
        from jax_aero.view.drawing import camera_at
        from jax_aero.view.painter import Painter
        from jax_aero.view.recording import from_flight

        flight = self._flight
        if not self._flown:
            flight = rust.Flight(self._config)
            flight.step()
        seen = from_flight(flight.result(), self._config, self.task.experiment)
        with Painter(seen, 640, 480) as scene:
            return np.asarray(scene.picture(seen.duration, camera_at(seen, seen.duration, "chase", 3.3)), np.uint8)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in OF_THE_CRATE}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._robot = rust.Robot(self._config["robot"])
        flown = self._flown
        self._begin(self._wind)
        for action in flown:
            self.step(action)

    def _begin(self, wind: list[float]) -> None:
        self._wind = wind
        drawn = {key: np.asarray(value).tolist() for key, value in self.task.wind(np, wind).items()}
        if self._seed is not None:
            drawn["seed"] = self._seed
        self._config = {**self._config, "wind": {**self._config["wind"], **drawn}}
        self._flight = rust.Flight(self._config, robot=self._robot)
        self._flown: list[NDArray[np.float64]] = []
        seen = rust.observe_flights([self._flight])
        self._first = self.task.aim(np, seen.com_position[0], seen.base_rotation[0])
        self._posture: NDArray[np.float64] = seen.joint_position[0]


Infos = dict[str, Any]


class HoverVectorEnv(gymnasium.vector.VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Fly many episodes of `HoverEnv` at once, on all cores.

    An episode that ends begins anew in the same step: `infos["final_obs"]` has the last observation of the ended one,
    `_final_obs` says which ones ended, and `infos["final_info"]` has their last parts of rewards. A seed is that of the
    first environment, the others have the next ones.

    Parameters
    ----------
    num_envs
        Number of environments.
    task, drawn, observation, reward
        As of `HoverEnv`.
    """

    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        num_envs: int = 64,
        task: Task | str | None = None,
        drawn: Sequence[Mapping[str, Any]] = (),
        observation: Observation = FEATURES,
        reward: Reward = env_task.rewards,
    ) -> None:
        # Gymnasium's own vector environments have it here too, where libraries ask for it.
        self.autoreset_mode = self.metadata["autoreset_mode"]
        self.num_envs = num_envs
        self.envs = [HoverEnv(task, drawn, observation=observation, reward=reward) for _ in range(num_envs)]
        first = self.envs[0]
        self.single_action_space, self.single_observation_space = first.action_space, first.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self,
        *,
        seed: SupportsIndex | Sequence[SupportsIndex | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Infos]:
        """Begin an episode of every environment."""
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        elif isinstance(seed, SupportsIndex) and np.ndim(cast(Any, seed)) == 0:  # also an integer of NumPy
            seeds = [index(seed) + number for number in range(self.num_envs)]
        else:
            seeds = [None if own is None else index(own) for own in cast(Sequence[SupportsIndex | None], seed)]
        infos: Infos = {}
        begun = [env.reset(seed=own, options=options) for env, own in zip(self.envs, seeds, strict=True)]
        for number, (_, info) in enumerate(begun):
            infos = self._add_info(infos, info, number)
        return np.array([obs for obs, _ in begun]), infos

    def step(
        self, actions: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Fly one tick of every environment."""
        clipped = env_task.limit_action(np, actions, (self.num_envs, self.envs[0]._size), np.float64)
        obs, lost, ended, parts = _step(self.envs, clipped)
        infos: Infos = dict(parts)
        for number in map(int, np.flatnonzero(lost | ended)):
            last = {name: float(values[number]) for name, values in parts.items()}
            infos = self._add_info(infos, {"final_obs": obs[number].copy(), "final_info": last}, number)
            obs[number], info = self.envs[number].reset()
            infos = self._add_info(infos, info, number)
        return obs, np.where(lost, 0.0, sum(parts.values())), lost, ended, infos


def _step(envs: Sequence[HoverEnv], actions: NDArray[np.float64]) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Fly one tick of each episode; return observations, which are lost, which are at their end, parts of rewards."""
    task, fall, jets = envs[0].task, envs[0]._fall, envs[0]._thrust_max.size
    residual = rust.Residual(*env_task.steer(task, actions, jets), task.steering == "rates")
    goes_on = rust.step_flights([env._flight for env in envs], residual)
    for env, action in zip(envs, actions, strict=True):
        env._flown.append(action)
    state, obs = _observe(envs)
    lost = ~goes_on | env_task.is_lost(np, state, fall) | ~np.isfinite(actions).all(axis=-1)
    ended = np.array([len(env._flown) >= env._last_tick for env in envs])
    return obs, lost, ended, dict(envs[0]._reward(np, state, actions))


def _observe(envs: Sequence[HoverEnv]) -> tuple[TaskState, NDArray[np.float32]]:
    """Return states and observations of episodes (envs, …)."""
    follows = envs[0].task.tracking
    seen = rust.observe_flights([env._flight for env in envs], setpoint=follows)
    state = TaskState(
        rotation=seen.base_rotation,
        velocity=seen.velocity,
        joint_position=seen.joint_position,
        thrust=seen.thrust,
        com=seen.com_position,
        aim=Aim(*seen[6:]) if follows else Aim(*map(np.array, zip(*(env._first for env in envs), strict=True))),
        posture=np.array([env._posture for env in envs]),
        wrench=seen.residual_wrench,
        thrust_max=envs[0]._thrust_max,
    )
    return state, env_task.observe(np, envs[0]._observation, state).astype(np.float32)


gymnasium.register(
    "jax_aero/Hover-v0", "jax_aero.env_gym:HoverEnv", vector_entry_point="jax_aero.env_gym:HoverVectorEnv"
)
