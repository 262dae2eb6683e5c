"""The flight as a Gymnasium environment: a loop over the crate's plant and controller, without JAX.

>>> from jax_aero.env_gym import HoverEnv
>>> hover = HoverEnv()
>>> obs, info = hover.reset(seed=0)
>>> obs, reward, terminated, truncated, info = hover.step(hover.action_space.sample())

Needs the extra `rl`. Task, observation and reward are those of `jax_aero.env`. Once this module is imported,
`gymnasium.make` has it as `jax_aero/Hover-v0`; `jax_aero.env_gym:jax_aero/Hover-v0` imports it.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium  # type: ignore[import-not-found,unused-ignore]
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.env_task import Aim, Task, TaskState, aim_of, is_lost, limit_action, observation, rewards, steer

__all__ = ["HoverEnv"]

LARGEST = 1e6
"""Bound that no observation reaches before the flight counts as lost."""

BETWEEN = (
    ("simulator", "sensors"),
    ("disturbances", "outages"),
    ("disturbances", "wind_estimate"),
    ("disturbances", "controller_wind"),
)
"""Tables and keys of a configuration that would alter signals between plant and controller."""


OF_THE_CRATE = {"_robot", "_plant", "_controller", "_measurement"}
"""Attributes that cannot be copied: they are made anew."""


class HoverEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Fly a task in a wind drawn anew for every episode; actions as in `jax_aero.env.FlightEnv`.

    A copy, also by `pickle`, flies the episode up to the present tick again.
    """

    _robot: rust.Robot
    _plant: rust.Plant
    _controller: rust.Controller
    _measurement: rust.Measurement
    _wrench: NDArray[np.float64]
    _aim: Aim
    metadata = {"render_modes": []}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(self, task: Task | None = None) -> None:
        self.task = task or Task()
        self._config = self.task.episode(rust.load_config(self.task.experiment))
        for table, key in BETWEEN:
            if self._config[table].get(key):
                expected = "expected none: here the controller is given what the plant measures"
                raise ValueError(f"`{table}.{key}` of {self.task.experiment} is given; {expected}")
        self._fall = SimpleNamespace(**self._config["simulator"]["fall"])
        self._robot = rust.Robot(self._config["robot"])
        self._thrust_max = np.array(self._robot.thrust_max)
        n, j = len(self._robot.joint_names), len(self._robot.jet_names)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (j + n,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-LARGEST, LARGEST, (21 + 2 * n + j,), np.float32)
        self.dt = float(self._config["simulator"]["time_step"])
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
        self._begin([float(part) for part in options.get("wind", drawn)])
        return self._observe()[1], {"wind": self._wind}

    def step(self, action: NDArray[np.floating]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Fly one tick."""
        now, jets = self._measurement, self._thrust_max.size
        clipped = limit_action(np, action, jets + self._posture.size, np.float64)
        residual = rust.Residual(*steer(self.task, clipped, jets), self.task.steering == "rates")
        tick = self._controller.tick(now.state, now.thrust, now.wind, now.time, residual=residual)
        self._wrench = tick.residual_wrench
        if self.task.tracking:
            self._aim = aim_of(tick.setpoint)
        self._measurement = self._plant.step(tick.thrust_rate, tick.joint_torque)
        self._flown.append(clipped)
        task_state, obs = self._observe()
        parts = {name: float(value) for name, value in rewards(np, task_state, clipped).items()}
        lost = bool(is_lost(np, task_state, self._fall)) or not np.isfinite(clipped).all()
        return obs, 0.0 if lost else sum(parts.values()), lost, len(self._flown) >= self._last_tick, parts

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
        self._plant, self._controller = rust.Plant(self._config), rust.Controller(self._config)
        self._measurement = self._plant.reset()
        self._flown: list[NDArray[np.float64]] = []
        self._wrench = np.zeros(6)
        state = self._measurement.state
        com = rust.dynamics(self._robot, state).com_position
        self._aim = Aim(com, np.array(state.base_rotation), np.zeros(3), np.zeros(3))
        self._posture: NDArray[np.float64] = np.array(state.joint_position)

    def _observe(self) -> tuple[TaskState, NDArray[np.float32]]:
        state = self._measurement.state
        task_state = TaskState(
            rotation=np.asarray(state.base_rotation),
            velocity=np.asarray(state.velocity),
            joint_position=np.asarray(state.joint_position),
            thrust=self._measurement.thrust,
            com=rust.dynamics(self._robot, state).com_position,
            aim=self._aim,
            posture=self._posture,
            wrench=self._wrench,
        )
        return task_state, observation(np, task_state, self._thrust_max).astype(np.float32)


gymnasium.register("jax_aero/Hover-v0", "jax_aero.env_gym:HoverEnv")
