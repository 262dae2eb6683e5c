"""Train a small network that adds to the baseline controller's commands, to hover in the wind: PPO of skrl.

    pip install 'skrl[jax]>=2.1'
    python residual.py

Ten times a second the network observes the flight and adds to the thrust rates of the controller.
The trained residual is compared with none, in winds that are drawn for the comparison alone.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # environments are processes of their own

import flax.linen as nn
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from skrl.agents.jax.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.jax import wrap_env
from skrl.memories.jax import RandomMemory
from skrl.models.jax import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.jax import RunningStandardScaler
from skrl.trainers.jax import SequentialTrainer
from skrl.utils import set_seed

from jax_aero.env_gym import HoverEnv
from jax_aero.env_task import Task

TASK = Task(experiment="test1", duration=10.0, wind_max=12.0, thrust_rate=50.0)
JETS = 4
TICKS_PER_ACTION = 10
"""An action is held for so many ticks of 0.01 s: exploration that changes in every tick averages out."""


class Residual(gymnasium.Wrapper):
    """Act on thrust rates alone; hold an action for `TICKS_PER_ACTION` ticks; the reward is the mean over them."""

    def __init__(self, env: HoverEnv) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (JETS,), np.float32)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Fly until the next action, or until the episode ends."""
        whole = np.zeros(self.env.action_space.shape, np.float32)
        whole[:JETS] = action
        total = 0.0
        for _ in range(TICKS_PER_ACTION):
            obs, reward, terminated, truncated, info = self.env.step(whole)
            total += reward
            if terminated or truncated:
                break
        return obs, total / TICKS_PER_ACTION, terminated, truncated, info


def make(task: Task = TASK) -> gymnasium.Env:
    """Return one environment."""
    return Residual(HoverEnv(task))


class Policy(GaussianMixin, Model):
    """A normal distribution of actions (4,); its mean is zero before training."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=True)

    @nn.compact
    def __call__(self, inputs: dict[str, Any], _: str = "") -> tuple[jax.Array, dict[str, Any]]:
        """Return means and logarithms of standard deviations."""
        hidden = nn.tanh(nn.Dense(32)(scale_observations(inputs["observations"])))
        mean = nn.Dense(self.num_actions, kernel_init=nn.initializers.zeros)(hidden)
        return mean, {"log_std": self.param("log_std", lambda _: jnp.full(self.num_actions, -0.7))}


class Value(DeterministicMixin, Model):
    """The expected return of an observation."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)

    @nn.compact
    def __call__(self, inputs: dict[str, Any], _: str = "") -> tuple[jax.Array, dict[str, Any]]:
        """Return values (batch, 1)."""
        hidden = nn.tanh(nn.Dense(64)(nn.tanh(nn.Dense(64)(scale_observations(inputs["observations"])))))
        return nn.Dense(1)(hidden), {}


def scale_observations(observations: jax.Array) -> jax.Array:
    """Return observations with rotation, position and velocity errors scaled to order one."""
    factors = np.ones(observations.shape[-1], np.float32)
    factors[3:15] = np.repeat([10.0, 5.0, 2.0, 2.0], 3)
    return jnp.clip(observations * factors, -5.0, 5.0)


def train(ticks: int, environments: int, seed: int) -> Callable[[np.ndarray], np.ndarray]:
    """Train for a number of ticks over all environments; return the residual: observation (71,) to action (4,)."""
    # Processes are forked before JAX starts its threads.
    vector = gymnasium.vector.AsyncVectorEnv([make] * environments, context="fork")
    vector.reset(seed=seed)
    set_seed(seed)
    env = wrap_env(vector, wrapper="gymnasium", verbose=False)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}
    models = {"policy": Policy(**spaces), "value": Value(**spaces)}
    for role, model in models.items():
        model.init_state_dict(role=role)
    settings = PPO_CFG(
        rollouts=50,
        learning_epochs=5,
        mini_batches=4,
        discount_factor=0.97,
        learning_rate=1e-3,
        entropy_loss_scale=0.0,
        kl_threshold=0.05,
        time_limit_bootstrap=True,
        value_preprocessor=RunningStandardScaler,
        value_preprocessor_kwargs={"size": 1, "device": env.device},
    )
    settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
    memory = RandomMemory(memory_size=settings.rollouts, num_envs=environments, device=env.device)
    agent = PPO(models=models, memory=memory, cfg=settings, **spaces)
    steps = ticks // (TICKS_PER_ACTION * environments)
    SequentialTrainer(
        env=env,
        agents=agent,
        cfg={"timesteps": steps, "headless": True, "disable_progressbar": True, "close_environment_at_exit": False},
    ).train()
    vector.close()
    policy = models["policy"]
    mean = jax.jit(lambda obs: jnp.clip(policy.apply(policy.state_dict.params, {"observations": obs})[0], -1.0, 1.0))
    return lambda obs: np.asarray(mean(obs))


def zero_residual(_: np.ndarray) -> np.ndarray:
    """Return the residual that changes nothing (4,)."""
    return np.zeros(JETS, np.float32)


def mean_rewards(act: Callable[[np.ndarray], np.ndarray], winds: np.ndarray, task: Task = TASK) -> np.ndarray:
    """Return the mean reward of a tick, at most 1, of one flight in each of the winds (w, 3) [m/s]: (w,)."""
    env, found = make(task), []
    for wind in winds:
        obs, _ = env.reset(options={"wind": wind})
        total, ended = 0.0, False
        while not ended:
            obs, reward, terminated, truncated, _ = env.step(act(obs))
            total, ended = total + reward, terminated or truncated
        found.append(total * TICKS_PER_ACTION * 0.01 / task.duration)
    return np.array(found)


def unseen_winds(count: int) -> np.ndarray:
    """Return winds of the task's distribution (count, 3) [m/s]."""
    rng = np.random.default_rng(2**40)
    speed, angle = rng.uniform(0.0, TASK.wind_max, count), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([speed * np.cos(angle), speed * np.sin(angle), np.zeros(count)])


def main() -> None:
    """Train, fly without and with the residual, print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=800_000, help="of training, over all environments")
    parser.add_argument("--environments", type=int, default=16, help="processes that fly")
    parser.add_argument("--winds", type=int, default=64, help="of the comparison")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    started = time.perf_counter()
    residual = train(given.ticks, given.environments, given.seed)
    spent = os.times()
    processor = spent.user + spent.system + spent.children_user + spent.children_system
    print(f"{given.ticks} ticks: {processor:.0f} s of processor time in {time.perf_counter() - started:.0f} s")
    winds = unseen_winds(given.winds)
    without, with_residual = mean_rewards(zero_residual, winds), mean_rewards(residual, winds)
    gain = with_residual - without
    draws = np.random.default_rng(1).choice(gain, (10_000, len(gain))).mean(axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    print(
        f"mean reward in {given.winds} unseen winds: {without.mean():.4f} without, {with_residual.mean():.4f} with it"
    )
    print(f"gain {gain.mean():.4f}, 95 % interval {low:.4f} to {high:.4f}; better in {np.mean(gain > 0.0):.0%}")


if __name__ == "__main__":
    main()
