"""The task of both environments: to hover or fly a mission in a wind that is drawn anew; its observation and reward.

Functions take `numpy` or `jax.numpy` as an argument, so that the environments of JAX and of the crate agree. Arrays are
of one robot, or have leading axes of several.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from jax_aero import rust
from jax_aero.base.features import Aim, features

Steering = Literal["residual", "rates"]
"""Meaning of an action: added to the controller's answer, or its replacement."""

Profile = Literal["ramp", "gust", "turbulent"]
"""Course of the wind: a rise to a constant wind, one gust of the same rise followed by still air, or a rise to a wind
with turbulence."""


@dataclass(frozen=True)
class Task:
    """The task to learn: to hover where the episode begins or near it, or to fly the experiment's mission.

    The set-point of a hover is the centre of mass and the attitude of the simulated robot at the first tick, unless
    `attitude_deg` and `offset` put it elsewhere. A controller with an error in its model or its sensors holds a
    slightly different one; the difference is part of the task. The set-point of a mission is the controller's. The
    posture is that of the first tick in both.
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
    turbulence: float = 0.2
    """Standard deviation of a turbulent wind's horizontal components over its speed; that of the vertical one is half
    as large."""
    time_scale: float = 2.0
    """Of the turbulence [s]."""
    thrust_rate: float = 20.0
    """Thrust rate of an action of 1 [N/s]."""
    joint_velocity: float = 0.5
    """Joint velocity of an action of 1 [rad/s]."""
    tracking: bool = False
    """Whether to fly the mission of the experiment, from its beginning, instead of hovering."""
    attitude_deg: tuple[float, float, float] | None = None
    """Attitude to hover in, roll, pitch and yaw as of `simulator.initial.base_rpy_deg`; `None` for that of the first
    tick. With a start that is tilted, the robot has to recover."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Set-point of the centre of mass from where it is at the first tick [m], inertial axes."""

    def __post_init__(self) -> None:
        if self.steering not in (known := get_args(Steering)):
            raise ValueError(f"`steering` is {self.steering!r}; expected one of {', '.join(known)}")
        if self.profile not in (known := get_args(Profile)):
            raise ValueError(f"`profile` is {self.profile!r}; expected one of {', '.join(known)}")
        for name in ("wind_max", "wind_min", "ramp", "turbulence", "time_scale", "thrust_rate", "joint_velocity"):
            _check(name, getattr(self, name), 0.0, "a number ≥ 0")
        if self.wind_min > self.wind_max:
            raise ValueError(f"`wind_min` is {self.wind_min}; expected at most `wind_max`, {self.wind_max}")
        for name in ("duration", "time_scale"):
            _check(name, getattr(self, name), math.ulp(0.0), "a number > 0")
        for name, numbers in (("attitude_deg", self.attitude_deg or (0.0,) * 3), ("offset", self.offset)):
            if np.shape(numbers) != (3,) or not np.all(np.isfinite(numbers)):
                raise ValueError(f"`{name}` is {numbers!r}; expected three finite numbers")
        if self.has_own_setpoint and (self.tracking or self.steering == "residual"):
            given = f"`attitude_deg` is {self.attitude_deg} and `offset` {self.offset}"
            expected = "expected neither with `tracking` or a residual: the controller has a set-point of its own"
            raise ValueError(f"{given}; {expected}")

    @property
    def has_own_setpoint(self) -> bool:
        """Return whether the set-point of a hover is apart from its start."""
        return self.attitude_deg is not None or any(self.offset)

    def wind(self, xp: Any, velocity: Any) -> dict[str, Any]:
        """Return the wind [m/s] of an episode at its strongest, by the keys of its configuration."""
        if self.profile == "gust":
            return {"gust": velocity}
        if self.profile == "ramp":
            return {"velocity": velocity}
        speed = xp.sqrt(xp.sum(xp.square(xp.asarray(velocity))))
        return {"velocity": velocity, "std": self.turbulence * speed * xp.asarray([1.0, 1.0, 0.5])}

    def aim(self, xp: Any, com: Any, rotation: Any) -> Aim:
        """Return the set-point of a hover that begins with this centre of mass and attitude."""
        if self.attitude_deg is not None:
            rotation = xp.asarray(_rotation(self.attitude_deg), rotation.dtype)
        still = xp.zeros_like(com)
        return Aim(com + xp.asarray(self.offset, com.dtype), rotation, still, still)

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
        if self.profile == "gust":
            wind |= {"gust": still, "start": 0.0, "duration": 2.0 * self.ramp}
        else:
            wind |= {"ramp_start": 0.0, "ramp_end": self.ramp}
        if self.profile == "turbulent":
            wind |= {"std": still, "time_scale": self.time_scale, "seed": 0}
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


def _rotation(rpy_deg: tuple[float, float, float]) -> Any:
    """Return the rotation by roll, pitch and yaw about fixed axes, as `simulator.initial.base_rpy_deg` has them.

    With NumPy alone, since Gymnasium's environment needs neither SciPy nor JAX.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(np.radians(rpy_deg)), np.sin(np.radians(rpy_deg))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


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
    thrust_max: Any
    """Greatest thrusts (j,) [N]."""


FEATURES = (
    *("gravity", "rotation", "position", "velocity", "angular_velocity"),
    *("joint_position", "joint_velocity", "thrust", "force", "moment"),
)
"""Names of all `features`, in their order: (3,) each, but for joints (n,) and thrusts (j,)."""

Observation: TypeAlias = Sequence[str] | Callable[[Any, TaskState], Any]
"""What an agent observes: names of `features`, which a card in the crate can have too, or a function from `numpy` or
`jax.numpy` and a state to an array."""
Reward: TypeAlias = Callable[[Any, TaskState, Any], Mapping[str, Any]]
"""Function from `numpy` or `jax.numpy`, a state and an action between −1 and 1 to the parts of a tick's reward."""


def observe(xp: Any, chosen: Observation, state: TaskState) -> Any:
    """Return the observation of an agent; that of all features has 21 + 2 n + j numbers."""
    if callable(chosen):
        return chosen(xp, state)
    seen = features(
        xp,
        state.rotation,
        state.velocity,
        state.joint_position - state.posture,
        state.thrust,
        state.com,
        state.aim,
        state.wrench,
        state.thrust_max,
    )
    return xp.concatenate([seen[name] for name in chosen], axis=-1)


def check_observation(chosen: Observation) -> None:
    """Refuse names that are those of no feature.

    Raises
    ------
    ValueError
        Naming them.
    """
    if not callable(chosen) and (not chosen or isinstance(chosen, str) or set(chosen) - set(FEATURES)):
        raise ValueError(f"`observation` is {chosen!r}; expected a function, or names of {', '.join(FEATURES)}")


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


def disturb(
    config: Mapping[str, Any],
    count: int,
    seed: int,
    *,
    duration: float = 10.0,
    push: float = 0.0,
    kick: float = 0.0,
    fade: float = 0.0,
    body: str = "chest",
) -> list[dict[str, Any]]:
    """Return configurations with drawn disturbances, for `drawn` of both environments.

    Parameters
    ----------
    config
        Configuration of a flight.
    count, seed
        Number of configurations, and of what they are drawn from.
    duration
        Of an episode [s]; what happens begins in its middle three fifths.
    push
        Greatest force [N], horizontal, for 0.2 s.
    kick
        Greatest moment [N m], about any axis, for 0.25 s.
    fade
        Time constant [s] with which a drawn jet loses its thrust; 0 for none.
    body
        Body that is pushed and kicked.
    """
    rng, drawn, jets = np.random.default_rng(seed), list[dict[str, Any]](), rust.Robot(config["robot"]).jet_names
    for _ in range(count):
        times = duration * rng.uniform(0.2, 0.8, 3)
        angle, axis = rng.uniform(0.0, 2.0 * np.pi), rng.normal(size=3)
        force = push * rng.uniform() * np.array([np.cos(angle), np.sin(angle), 0.0])
        moment = kick * rng.uniform() * axis / np.linalg.norm(axis)
        jet = jets[rng.integers(len(jets))]
        disturbances = dict(config.get("disturbances", {}))
        own = [
            {"body": body, "force": [*map(float, force)], "start": float(times[0]), "duration": 0.2},
            {"body": body, "moment": [*map(float, moment)], "start": float(times[1]), "duration": 0.25},
        ]
        wanted = [entry for entry, size in zip(own, (push, kick), strict=True) if size > 0.0]
        if wanted:
            disturbances["pushes"] = [*disturbances.get("pushes", []), *wanted]
        if fade > 0.0:
            failure = {"jet": jet, "time": float(times[2]), "kind": "off", "decay": fade}
            disturbances["jets"] = {**disturbances.get("jets", {}), "failure": failure}
        drawn.append({**config, "disturbances": disturbances})
    return drawn
