"""The flight as a Gymnasium environment: `rust.Flight` with the action as its residual, without JAX.

Examples
--------
>>> from jax_aero.env_gym import HoverEnv
>>> hover = HoverEnv()
>>> obs, info = hover.reset(seed=0)
>>> obs, reward, terminated, truncated, info = hover.step(hover.action_space.sample())

Needs the extra `rl`. Task, observation and reward are those of `jax_aero.env`. Once this module is imported,
`gymnasium.make` has it as `jax_aero/Hover-v0`; `jax_aero.env_gym:jax_aero/Hover-v0` imports it. Sensors, outages and
faults of the experiment act on the controller; what is observed is the true state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Literal

import gymnasium  # type: ignore[import-not-found,unused-ignore]
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.features import Aim, aim_of
from jax_aero.env_task import Task, TaskState, is_lost, limit_action, observation, rewards, steer, task_of

__all__ = ["HoverEnv"]

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
    ) -> None:
        self.task, self.render_mode = task_of(task), render_mode
        configs = list(drawn) or [rust.load_config(self.task.experiment)]
        self._drawn = [self.task.episode(config) for config in configs]
        self._config = self._drawn[0]
        self._fall = SimpleNamespace(**self._config["simulator"]["fall"])
        self._robot = rust.Robot(self._config["robot"])
        self._thrust_max = np.array(self._robot.thrust_max)
        n, j = len(self._robot.joint_names), len(self._robot.jet_names)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (j + n,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-LARGEST, LARGEST, (21 + 2 * n + j,), np.float32)
        self.dt = float(self._config["controller"]["time_step"])
        self._last_tick = self.task.ticks(self.dt)
        self._begin([0.0, 0.0, 0.0])

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
        if len(self._drawn) > 1:
            self._config = self._drawn[self.np_random.integers(len(self._drawn))]
        self._begin([float(part) for part in options.get("wind", drawn)])
        return self._observe()[1], {"wind": np.array(self._wind)}

    def step(self, action: NDArray[np.floating]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Fly one tick."""
        jets = self._thrust_max.size
        clipped = limit_action(np, action, jets + self._posture.size, np.float64)
        residual = rust.Residual(*steer(self.task, clipped, jets), self.task.steering == "rates")
        goes_on = self._flight.step(residual=residual)
        self._flown.append(clipped)
        task_state, obs = self._observe()
        parts = {name: float(value) for name, value in rewards(np, task_state, clipped).items()}
        lost = not goes_on or bool(is_lost(np, task_state, self._fall)) or not np.isfinite(clipped).all()
        return obs, 0.0 if lost else sum(parts.values()), lost, len(self._flown) >= self._last_tick, parts

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
        self._config = {**self._config, "wind": {**self._config["wind"], self.task.wind_key: wind}}
        self._flight = rust.Flight(self._config)
        self._flown: list[NDArray[np.float64]] = []
        state = self._flight.truth.state
        com = rust.dynamics(self._robot, state).com_position
        self._first = Aim(com, np.array(state.base_rotation), np.zeros(3), np.zeros(3))
        self._posture: NDArray[np.float64] = np.array(state.joint_position)

    def _observe(self) -> tuple[TaskState, NDArray[np.float32]]:
        now = self._flight.truth
        task_state = TaskState(
            rotation=np.asarray(now.state.base_rotation),
            velocity=np.asarray(now.state.velocity),
            joint_position=np.asarray(now.state.joint_position),
            thrust=now.thrust,
            com=rust.dynamics(self._robot, now.state).com_position,
            aim=aim_of(self._flight.try_tick().setpoint) if self.task.tracking else self._first,
            posture=self._posture,
            wrench=self._flight.residual_wrench,
        )
        return task_state, observation(np, task_state, self._thrust_max).astype(np.float32)


gymnasium.register("jax_aero/Hover-v0", "jax_aero.env_gym:HoverEnv")
