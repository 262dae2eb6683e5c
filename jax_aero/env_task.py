"""The task of both environments: to hover or fly a mission in a wind that is drawn anew; its observation and reward.

Functions take `numpy` or `jax.numpy` as an argument, so that the environments of JAX and of the crate agree. Arrays are
of one robot, or have leading axes of several.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, NamedTuple, get_args

from jax_aero.base.features import Aim, features

Steering = Literal["residual", "rates"]
"""Meaning of an action: added to the controller's answer, or its replacement."""

Profile = Literal["ramp", "gust"]
"""Course of the wind: a rise to a constant wind, or one gust of the same rise, followed by still air."""


@dataclass(frozen=True)
class Task:
    """The task to learn: to hover where the episode begins, or to fly the experiment's mission.

    The set-point of a hover is the centre of mass and the attitude of the simulated robot at the first tick. A
    controller with an error in its model or its sensors holds a slightly different one; the difference is part of the
    task. The set-point of a mission is the controller's. The posture is that of the first tick in both.
    """

    experiment: str = "test1"
    """Robot, simulator and controller: an experiment by name or path. Its wind is replaced."""
    steering: Steering = "residual"
    duration: float = 10.0
    """Duration of an episode [s]."""
    wind_max: float = 12.0
    """Greatest wind [m/s]; speed and horizontal direction are drawn uniformly."""
    wind_min: float = 0.0
    """Least wind [m/s]."""
    profile: Profile = "ramp"
    ramp: float = 1.0
    """Time in which the wind rises [s]; a gust takes twice as long."""
    thrust_rate: float = 20.0
    """Thrust rate of an action of 1 [N/s]."""
    joint_velocity: float = 0.5
    """Joint velocity of an action of 1 [rad/s]."""
    tracking: bool = False
    """Whether to fly the mission of the experiment, from its beginning, instead of hovering."""

    def __post_init__(self) -> None:
        if self.steering not in (known := get_args(Steering)):
            raise ValueError(f"`steering` is {self.steering!r}; expected one of {', '.join(known)}")
        if self.profile not in (known := get_args(Profile)):
            raise ValueError(f"`profile` is {self.profile!r}; expected one of {', '.join(known)}")
        for name in ("wind_max", "wind_min", "ramp", "thrust_rate", "joint_velocity"):
            _check(name, getattr(self, name), 0.0, "a number ≥ 0")
        if self.wind_min > self.wind_max:
            raise ValueError(f"`wind_min` is {self.wind_min}; expected at most `wind_max`, {self.wind_max}")
        _check("duration", self.duration, math.ulp(0.0), "a number > 0")

    @property
    def wind_key(self) -> str:
        """Return the key of the wind that is drawn."""
        return {"ramp": "velocity", "gust": "gust"}[self.profile]

    def ticks(self, time_step: float) -> int:
        """Return the length of an episode.

        Raises
        ------
        ValueError
            If the duration is invalid.
        """
        if (ticks := round(self.duration / time_step)) < 1:
            raise ValueError(f"`duration` is {self.duration}; expected at least one time step of {time_step} s")
        return ticks

    def episode(self, config: Mapping[str, Any]) -> dict[str, Any]:
        """Return the configuration of an episode in still air, from that of the experiment.

        Raises
        ------
        ValueError
            If the experiment's controller measures the mean of the wind, or computes torques several times in a tick.
        """
        if (steps := config["controller"]["torque"].get("steps", 1)) > 1:
            expected = "expected 1: an action acts for a tick"
            raise ValueError(f"`controller.torque.steps` of {self.experiment} is {steps}; {expected}")
        if (config.get("disturbances", {}).get("wind_estimate") or {}).get("mean_only"):
            expected = "expected false: no mean of a wind is known before it is drawn"
            raise ValueError(f"`disturbances.wind_estimate.mean_only` of {self.experiment} is true; {expected}")
        still = [0.0, 0.0, 0.0]
        wind: dict[str, Any] = {"profile": self.profile, "velocity": still}
        if self.profile == "ramp":
            wind |= {"ramp_start": 0.0, "ramp_end": self.ramp}
        else:
            wind |= {"gust": still, "start": 0.0, "duration": 2.0 * self.ramp}
        simulator = {**config["simulator"], "duration": self.duration}
        mission = config["mission"] if self.tracking else {}
        return {**config, "mission": mission, "wind": wind, "simulator": simulator}


def task_of(given: Task | str | None) -> Task:
    """Return a task: itself, a hover in an experiment given by name or path, or the default one."""
    if isinstance(given, str):
        return Task(experiment=given)
    if not isinstance(given, Task | None):
        raise ValueError(f"`task` is {given!r}; expected a Task, or the name of an experiment")
    return given or Task()


def _check(name: str, value: Any, least: float, expected: str) -> None:
    if not isinstance(value, Real) or not least <= float(value) < math.inf:
        raise ValueError(f"`{name}` is {value!r}; expected {expected}")


class TaskState(NamedTuple):
    """State for observation and reward, in inertial axes unless a suffix says otherwise."""

    rotation: Any
    """`inertial_from_base` (3, 3)."""
    velocity: Any
    """ν (6 + n,) [m/s, rad/s]."""
    joint_position: Any
    """(n,) [rad]."""
    thrust: Any
    """(j,) [N]; the estimated one where `jets.feedback` is "estimated"."""
    com: Any
    """Centre of mass (3,) [m]."""
    aim: Aim
    posture: Any
    """Joint positions of the first tick (n,) [rad]."""
    wrench: Any
    """Observed wrench about the centre of mass (6,) [N, N m]."""


def observation(xp: Any, state: TaskState, thrust_max: Any) -> Any:
    """Return the observation of an agent (21 + 2 n + j,): all `features`, in their order."""
    seen = features(
        xp,
        state.rotation,
        state.velocity,
        state.joint_position - state.posture,
        state.thrust,
        state.com,
        state.aim,
        state.wrench,
        thrust_max,
    )
    return xp.concatenate(list(seen.values()), axis=-1)


def rewards(xp: Any, state: TaskState, action: Any) -> dict[str, Any]:
    """Return the parts of the reward of one tick, each at most its value for a perfect flight; the sum is at most 1.

    `action` is as returned by `limit_action`.
    """
    return {
        "attitude": 0.5 * xp.exp(-20.0 * (1.0 - _cosine(xp, state))),
        "position": 0.5 * xp.exp(-20.0 * xp.sum((state.com - state.aim.com) ** 2, axis=-1)),
        "effort": -0.01 * xp.sum(action**2, axis=-1) / max(action.shape[-1], 1),
    }


def is_lost(xp: Any, state: TaskState, limits: Any) -> Any:
    """Return whether the robot has fallen, by the limits of `simulator.fall`; a state with NaN counts as fallen."""
    turned = xp.degrees(xp.arccos(xp.clip(_cosine(xp, state), -1.0, 1.0)))
    is_near = xp.sum((state.com - state.aim.com) ** 2, axis=-1) <= limits.com_error**2
    return ~((turned <= limits.rotation_error_deg) & is_near)


def _cosine(xp: Any, state: TaskState) -> Any:
    """Return that of the angle between base and set-point, of the trace of R_dᵀ R."""
    return 0.5 * (xp.sum(state.aim.rotation * state.rotation, axis=(-2, -1)) - 1.0)


def limit_action(xp: Any, action: Any, expected: tuple[int, ...], dtype: Any) -> Any:
    """Return an action limited to −1 to 1.

    Raises
    ------
    ValueError
        If the shape is not the expected one.
    """
    if (shape := xp.shape(action)) != expected:
        raise ValueError(f"`action` has shape {shape}; expected {expected}")
    return xp.clip(xp.asarray(action, dtype), -1.0, 1.0)


def steer(task: Task, action: Any, jets: int) -> tuple[Any, Any]:
    """Return the thrust rates [N/s] and joint velocities [rad/s] of an action between −1 and 1."""
    return task.thrust_rate * action[..., :jets], task.joint_velocity * action[..., jets:]
