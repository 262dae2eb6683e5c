"""Hovering learnt from nothing: a policy replaces the controller's law, and is judged by whole unseen episodes.

A configuration names the experiment whose robot hovers in an unknown wind, the effect of an action, and the settings of
a training, by gradients through the flight or by PPO; one policy is trained per seed, in single precision. It is judged
in episodes of other winds and starts than those of the training: in some while it is trained, in all at the end. An
interrupted run is resumed by the same command.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from experiments.studies.policy import ppo
from jax_aero import rust
from jax_aero.base import plain_values, tables
from jax_aero.base.cards import card_text
from jax_aero.base.features import Aim
from jax_aero.base.terminal import ConfigError
from jax_aero.body.robot import load_robot
from jax_aero.control.law.policy_card import make_card
from jax_aero.env import FlightEnv
from jax_aero.env_task import Profile, Steering, Task, TaskState, disturb, is_lost, rewards
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.train import policy
from jax_aero.train.policy import Network, Row, Settings, Trainer, TrainingResult, approach, fly_episodes, residual_of

TRAINING, JUDGEMENT = 2**41, 2**40
"""Seeds of starts of training and judgement, and of the winds of the latter."""
SOON = 0.9
"""Reward whose time is recorded."""
CHUNK = 64
"""Episodes that are judged at once, and all of them while a policy is trained."""


class Disturbed(tables.Table, frozen=True):
    """What is drawn beside the starts, as by `env_task.disturb`."""

    push: tables.NonNegative = 0.0
    """Greatest force on the chest for 0.2 s [N]."""
    kick: tables.NonNegative = 0.0
    """Greatest moment on the chest for 0.25 s [N m]."""


class PolicyConfig(tables.Table, frozen=True):
    """One file of `experiments/studies/policy/`."""

    title: str
    gradients: Settings | None = None
    """Training by gradients through the flight."""
    ppo: ppo.Settings | None = None
    """Training by proximal policy optimisation instead."""
    experiment: str = "test1"
    """Robot, simulator and controller."""
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    """Changes of the experiment, by key."""
    steering: Steering = "rates"
    start: Perturbation = Perturbation()
    """Half widths of the distributions of starts, and of whatever else an episode draws."""
    disturbed: Disturbed = Disturbed()
    """Greatest disturbances of an episode."""
    duration: tables.Positive = 10.0
    """Duration of an episode [s]."""
    profile: Profile = "ramp"
    """Course of the wind."""
    wind_max: tables.Positive = 12.0
    """Greatest wind [m/s]."""
    thrust_rate: tables.Positive = 200.0
    """Thrust rate of an action of 1 [N/s]."""
    joint_velocity: tables.Positive = 2.0
    """Joint velocity of an action of 1 [rad/s]."""
    ahead: tables.NonNegative = 0.3
    """Time constant of the approach that is rewarded in a training by gradients [s]."""
    seeds: Annotated[tuple[tables.Seed, ...], msgspec.Meta(min_length=1)] = (0, 1, 2, 3, 4)
    starts: tables.Count = 128
    """Starts that are drawn for the training; each episode draws one of them, and its wind."""
    episodes: tables.Count = 256
    """Episodes in which a policy is judged at the end."""
    judge_every: tables.Count = 100
    """Steps of the training between two judgements."""

    def __post_init__(self) -> None:
        if len(set(self.seeds)) < len(self.seeds):
            raise ConfigError.of("seeds", self.seeds, "each seed once")
        if (self.gradients is None) == (self.ppo is None):
            raise ConfigError.of("ppo", "given" if self.ppo else "absent", "a table where there is no `gradients`")
        if self.episodes % CHUNK:
            raise ConfigError.of("episodes", self.episodes, f"a multiple of {CHUNK}")

    @property
    def task(self) -> Task:
        """Return the task."""
        return Task(
            self.experiment,
            self.steering,
            duration=self.duration,
            profile=self.profile,
            wind_max=self.wind_max,
            thrust_rate=self.thrust_rate,
            joint_velocity=self.joint_velocity,
        )

    def training(self) -> tuple[Trainer, Network]:
        """Return the training, and the network that it trains."""
        drawn = self.drawn(TRAINING, self.starts)
        if self.gradients is not None:
            env = FlightEnv(self.task, drawn, reward=approach(self.ahead))
            network = policy.perceptron(env, self.gradients.hidden)
            return policy.trainer(env, self.gradients, network), network
        assert self.ppo is not None
        env = FlightEnv(self.task, drawn)
        return ppo.trainer(env, self.ppo), ppo.network_of(env, self.ppo)

    @property
    def flight(self) -> rust.Config:
        """Return the experiment with its changes."""
        return rust.load_config(self.experiment, self.set)

    def drawn(self, seed: int, count: int) -> list[dict[str, Any]]:
        """Return configurations with other starts and disturbances."""
        config, most = self.flight, self.disturbed
        robot = rust.Robot(config["robot"])
        drawn = disturb(config, count, seed, duration=self.duration, push=most.push, kick=most.kick)
        drawn = [copy.deepcopy(one) for one in drawn]  # whose parts are shared
        for repeat, one in enumerate(drawn):
            self.start.apply(one, seed, repeat, robot)
        return drawn


class Judged(tables.Table, frozen=True):
    """A judgement."""

    step: int
    minutes: float
    """Processor time of the training [min]."""
    reward: float
    """Mean of a tick."""
    survived: float
    """Share of the episodes."""


Judge = Callable[[Any, int], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Function from parameters and a number of episodes to their mean rewards and whether they survive."""


def compute(_: str, config: PolicyConfig, work: Work) -> Findings:
    """Train, resuming an interrupted run, and judge."""
    task, seeds = config.task, config.seeds
    flight = config.flight
    with jax.enable_x64(False):
        trainer, network = config.training()
        judge = judge_of(config, network)
        runs = [_train(trainer, seed, config, judge, work) for seed in seeds]
        pairs = [judge(run.parameters, config.episodes) for run, _ in runs]
    earned, survived = (np.array(of) for of in zip(*pairs, strict=True))
    summary: dict[str, Any] = {}
    texts: dict[str, str | bytes] = {}
    robot = load_robot(flight["robot"])
    for seed, of, alive, (run, judged) in zip(seeds, earned, survived, runs, strict=True):
        soon = [one.minutes for one in judged if one.reward >= SOON]
        summary[f"seed {seed}"] = figures = {
            "reward": float(of.mean()),
            "fallen": int(np.sum(alive < 1.0)),
            "processor [min]": sum(row.processor for row in run.rows) / 60.0,
            "wall [min]": sum(row.wall for row in run.rows) / 60.0,
            f"processor to a reward of {SOON} [min]": soon[0] if soon else None,
        }
        if not isinstance(network, policy.Perceptron):
            continue  # a card has no moments of observations
        card, weights = make_card(
            f"seed_{seed}",
            residual_of(network.to_policy(run.parameters), task, robot.jets.count),
            robot,
            description=f"{config.title}: {task.experiment}, seed {seed}.",
            training={
                "task": dataclasses.asdict(task),
                "settings": {**plain_values.to_builtins(config.gradients), "ahead": config.ahead},
                "seed": seed,
                "flight": rust.config_digest(flight),
                **figures,
            },
        )
        texts |= {f"seed_{seed}.json": card_text(card), f"seed_{seed}.safetensors": weights}
    dataset = to_dataset(config, [of for _, of in runs], earned, survived)
    shipped = {task.experiment: rust.load_config(task.experiment)}
    return Findings(config.title, dataset, summary, flights=shipped, texts=texts)


def judge_of(config: PolicyConfig, network: Network) -> Judge:
    """Return the judge of a configuration's policies: by the task's reward, whatever they are trained by."""
    env = FlightEnv(config.task, config.drawn(JUDGEMENT, config.episodes))
    winds = jnp.asarray(draw_winds(JUDGEMENT, config.episodes, config.task))
    fly = jax.jit(lambda *of: fly_episodes(env, network, *of), compiler_options=COMPILER_OPTIONS)

    def judge(parameters: Any, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        numbers = np.arange(count).reshape(-1, CHUNK)
        parts = [fly(parameters, winds[chunk], jnp.asarray(chunk)) for chunk in numbers]
        earned, survived = (np.concatenate(of, dtype=np.float64) for of in zip(*parts, strict=True))
        return earned, survived

    return judge


def _train(
    trainer: Trainer, seed: int, config: PolicyConfig, judge: Judge, work: Work
) -> tuple[TrainingResult, list[Judged]]:
    """Train the policy of a seed, and judge it on the way."""
    job = f"judged {seed}"
    judged = [tables.convert(one, Judged, job) for one in work.read_json(job) or []]

    def on_step(step: int, trained: Any, rows: list[Row]) -> None:
        if step == len(rows) == 1:
            print(f"seed {seed}: the first of {trainer.steps} steps, with compilation, took {rows[0].wall:.0f} s")
        if step % config.judge_every:
            return
        earned, survived = judge(trained, CHUNK)
        minutes = sum(row.processor for row in rows) / 60.0
        judged[:] = [one for one in judged if one.step < step]
        judged.append(Judged(step=step, minutes=minutes, reward=earned.mean(), survived=survived.mean()))
        work.write_json(job, [plain_values.to_builtins(one) for one in judged])
        print(f"seed {seed}, step {step}, {minutes:.1f} min: reward {earned.mean():.3f}, {survived.mean():.0%} survive")

    run = trainer.train(seed, checkpoint=work.path(f"seed {seed}"), digest=work.of, on_step=on_step)
    return run, judged


def rewards_in_crate(config: dict[str, Any], task: Task) -> list[float]:
    """Return the reward of every tick of an episode that the crate flies alone; it is shorter if the robot is lost."""
    flight, robot, fall = (
        rust.Flight(config),
        rust.Robot(config["robot"]),
        SimpleNamespace(**config["simulator"]["fall"]),
    )
    effects = np.repeat([task.thrust_rate, task.joint_velocity], [len(robot.jet_names), len(robot.joint_names)])
    nothing, still, earned = np.zeros(0), np.zeros(3), list[float]()
    first = flight.truth.state
    aim = Aim(rust.dynamics(robot, first).com_position, np.asarray(first.base_rotation), still, still)
    for _ in range(task.ticks(config["controller"]["time_step"])):
        goes_on, now = flight.step(), flight.truth.state
        com = rust.dynamics(robot, now).com_position
        seen = TaskState(np.asarray(now.base_rotation), nothing, nothing, nothing, com, aim, nothing, nothing, nothing)
        if not goes_on or is_lost(np, seen, fall):
            break
        earned.append(float(sum(rewards(np, seen, flight.last.residual / effects).values())))
    return earned


STUDY = Study("policy", __doc__, PolicyConfig, compute, ("hover",), backend="jax", resumes=True)
main = STUDY.main


def draw_winds(seed: int, count: int, task: Task) -> NDArray[np.float64]:
    """Return winds of the task's distribution (count, 3) [m/s]."""
    rng = np.random.default_rng(seed)
    speed, angle = rng.uniform(task.wind_min, task.wind_max, count), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([speed * np.cos(angle), speed * np.sin(angle), np.zeros(count)])


def to_dataset(
    config: PolicyConfig, judged: list[list[Judged]], earned: NDArray[np.float64], survived: NDArray[np.float64]
) -> xr.Dataset:
    """Return curves, rewards and losses as a labelled dataset."""
    meaning = {
        "minutes": ("min", "processor time of the training"),
        "reward": ("1", "mean reward of whole unseen episodes"),
        "survived": ("1", "share of whole unseen episodes that survive"),
    }
    courses = {key: [[getattr(one, key) for one in of] for of in judged] for key in meaning}
    curves = {
        key: (("seed", "judgement"), courses[key], {"units": unit, "long_name": text})
        for key, (unit, text) in meaning.items()
    }
    final = {
        "final_reward": (("seed", "episode"), earned, {"units": "1", "long_name": "mean reward of an episode"}),
        "final_survived": (("seed", "episode"), survived, {"units": "1", "long_name": "1 for a flight that survives"}),
    }
    winds = draw_winds(JUDGEMENT, config.episodes, config.task)
    blown = {"wind": (("episode", "axis"), winds, {"units": "m s-1", "long_name": "wind after its rise"})}
    steps = [one.step for one in judged[0]]
    return xr.Dataset({**curves, **final, **blown}, {"seed": list(config.seeds), "step": ("judgement", steps)})
