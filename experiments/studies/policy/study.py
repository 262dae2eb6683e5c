"""A residual on a controller, learnt by gradients through short flights, judged in winds that training did not use.

A configuration names the experiment whose controller hovers in an unknown wind, the effect of an action, and the
settings of the training; one policy is trained per seed. The crate then flies one episode per wind: with the
controller alone, with every policy, and with the controllers of other experiments. An interrupted run is resumed
by the same command. Compilation takes minutes, once if JAX_COMPILATION_CACHE_DIR is set.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import jax
import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import plain, tables
from jax_aero.base.cards import card_text
from jax_aero.base.terminal import ConfigError
from jax_aero.body.robot import load_robot
from jax_aero.control.law.policy_card import make_card
from jax_aero.control.law.residual import Policy
from jax_aero.env import FlightEnv
from jax_aero.env_gym import HoverEnv
from jax_aero.env_task import Task
from jax_aero.results.identity import Identity
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.train.policy import Settings, act, residual_of, train

SEED = 2**40
"""Seed of the winds in which policies are judged."""
DRAWS = 10_000
"""Number of draws of a bootstrapped interval."""


class PolicyConfig(tables.Table, frozen=True):
    """One file of `experiments/studies/policy/`."""

    title: str
    experiment: str
    """Robot, simulator and controller."""
    training: Settings
    compared: tuple[str, ...] = ()
    """Experiments whose controllers fly the same episodes without a policy."""
    duration: tables.Positive = 10.0
    """Duration of an episode [s]."""
    wind_max: tables.Positive = 12.0
    """Greatest wind [m/s]."""
    thrust_rate: tables.Positive = 100.0
    """Thrust rate of an action of 1 [N/s]."""
    joint_velocity: tables.Positive = 1.0
    """Joint velocity of an action of 1 [rad/s]."""
    seeds: Annotated[tuple[tables.Seed, ...], msgspec.Meta(min_length=1)] = (0, 1, 2)
    winds: tables.Count = 64
    """Winds in which policies are judged."""

    def __post_init__(self) -> None:
        if len(set(self.seeds)) < len(self.seeds):
            raise ConfigError.of("seeds", self.seeds, "each seed once")

    @property
    def task(self) -> Task:
        """Return the task."""
        return Task(
            self.experiment,
            duration=self.duration,
            wind_max=self.wind_max,
            thrust_rate=self.thrust_rate,
            joint_velocity=self.joint_velocity,
        )


def compute(_: str, config: PolicyConfig, work: Work) -> Findings:
    """Train, resuming an interrupted run, and judge."""
    task, training, seeds = config.task, config.training, config.seeds
    flights = {base: rust.load_config(base) for base in (task.experiment, *config.compared)}
    digests = {key: rust.config_digest(one) for key, one in flights.items()}
    work = work.narrowed(Identity.of(digests))
    started = time.process_time()
    with jax.enable_x64(True):
        found = train(
            FlightEnv(task),
            training,
            seeds,
            checkpoint=work.path("steps"),
            digest=work.of,
        )
    trained = time.process_time() - started
    winds = draw_winds(SEED, config.winds, task)
    policies = {f"seed {seed}": found.policy(number) for number, seed in enumerate(seeds)}
    rewards = {task.experiment: mean_rewards(task, winds)}
    rewards |= {key: mean_rewards(task, winds, policy) for key, policy in policies.items()}
    rewards |= {other: mean_rewards(replace(task, experiment=other), winds) for other in config.compared}
    gains = np.array([rewards[key] - rewards[task.experiment] for key in policies])
    low, high = interval(gains)
    summary: dict[str, Any] = {f"mean reward, {key}": float(np.mean(values)) for key, values in rewards.items()}
    summary |= {
        "gain": float(gains.mean()),
        "gain, 95 % interval, low": low,
        "gain, 95 % interval, high": high,
        "share of flights that are better": float(np.mean(gains > 0.0)),
        "ticks of training, per seed": training.steps * training.batch * training.ticks,
        "flights left out of steps": int(sum(sum(curve.left_out) for curve in found.curves)),
    }
    timings = {
        "processor, training": trained,
        "processor, flights of judgement": time.process_time() - started - trained,
    }
    texts: dict[str, str | bytes] = {}
    robot = load_robot(flights[task.experiment]["robot"])
    for number, seed in enumerate(seeds):
        card, weights = make_card(
            f"seed_{seed}",
            residual_of(found.policy(number), task, robot.jets.count),
            robot,
            description=f"{config.title}: {task.experiment}, seed {seed}.",
            training={
                "task": dataclasses.asdict(task),
                "settings": plain.to_builtins(training),
                "seed": seed,
                "flight": digests[task.experiment],
                "mean_reward": float(rewards[f"seed {seed}"].mean()),
                "mean_reward_without": float(rewards[task.experiment].mean()),
            },
        )
        texts |= {f"seed_{seed}.json": card_text(card), f"seed_{seed}.safetensors": weights}
    dataset = to_dataset(seeds, [curve.reward for curve in found.curves], winds, rewards, found.policies)
    dataset.attrs["ticks_per_step"] = training.batch * training.ticks
    return Findings(config.title, dataset, summary, flights=flights, timings=timings, texts=texts)


STUDY = Study(
    "policy",
    __doc__,
    PolicyConfig,
    compute,
    ("hover",),
    backend="jax",
    resumes=True,
)
main = STUDY.main


def draw_winds(seed: int, count: int, task: Task) -> NDArray[np.float64]:
    """Return winds of the task's distribution (count, 3) [m/s]."""
    rng = np.random.default_rng(seed)
    speed, angle = rng.uniform(task.wind_min, task.wind_max, count), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([speed * np.cos(angle), speed * np.sin(angle), np.zeros(count)])


def mean_rewards(
    task: Task,
    winds: NDArray[np.float64],
    policy: Policy | None = None,
) -> NDArray[np.float64]:
    """Return the mean reward of a tick, at most 1, of one flight of the crate in each of the winds (w, 3) [m/s]."""
    env, found = HoverEnv(task), []
    nothing = np.zeros(env.action_space.shape or ())
    for wind in winds:
        obs, _ = env.reset(options={"wind": wind})
        total, ended = 0.0, False
        while not ended:
            action = nothing if policy is None else act(np, policy, obs)
            obs, reward, terminated, truncated, _ = env.step(action)
            total, ended = total + reward, terminated or truncated
        found.append(total / task.ticks(env.dt))
    return np.array(found)


def interval(gains: NDArray[np.float64]) -> tuple[float, float]:
    """Return the bootstrapped 95 % interval of the mean over seeds and winds (s, w), both drawn."""
    rng = np.random.default_rng(1)
    seeds, winds = (rng.integers(size, size=(DRAWS, size)) for size in gains.shape)
    means = [gains[np.ix_(*chosen)].mean() for chosen in zip(seeds, winds, strict=True)]
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def to_dataset(
    seeds: Sequence[int],
    curve: Sequence[Sequence[float]],
    winds: NDArray[np.float64],
    rewards: Mapping[str, NDArray[np.float64]],
    policies: Policy,
) -> xr.Dataset:
    """Return curve, rewards and weights as a labelled dataset."""
    axes = {
        "hidden": ("unit", "feature"),
        "hidden_bias": ("unit",),
        "output": ("action", "unit"),
        "direct": ("action", "feature"),
        "output_bias": ("action",),
    }
    return xr.Dataset(
        {
            "reward": (
                ("step", "seed"),
                np.array(curve),
                {"units": "1", "long_name": "mean reward of the flights of a step"},
            ),
            "unseen_reward": (
                ("flown", "number"),
                np.array(list(rewards.values())),
                {"units": "1", "long_name": "mean reward of a flight in a wind that training did not use"},
            ),
            "wind": (("number", "axis"), winds, {"units": "m s-1", "long_name": "wind after its rise"}),
            **{
                key: (("seed", *names), np.asarray(getattr(policies, key)), {"units": "1"})
                for key, names in axes.items()
            },
        },
        {
            "step": np.arange(len(curve)),
            "seed": list(seeds),
            "flown": list(rewards),
            "number": np.arange(len(winds)),
            "axis": ["x", "y", "z"],
        },
    )
