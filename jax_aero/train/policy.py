"""Training of a policy (`control.law.residual`) by gradients through short flights: analytic policy gradient.

```text
x = s ∘ o                                     features of base and observed wrench in the observation o
J = 1/n Σ r                                   of a window of n ticks, which begins where the last one ended
```

Windows of one step begin at times that are spread over the episode; a flight begins anew, in another wind, when its
episode ends or when it is lost. The gradient of a flight that is about to be lost is larger by orders of magnitude, so
flights whose gradient is longer than `gradient_max`, or not finite, are left out of a step, and counted. Several seeds
are trained at once, as a batch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key

from jax_aero.base import tables
from jax_aero.control.law.residual import Policy, PolicyResidual, evaluate
from jax_aero.env import EnvState, FlightEnv, Task
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jax_aero.types import Array, leaf, pytree, where

BASE, WRENCH = 15, 6
"""Numbers of an observation that describe the base, at its beginning, and the observed wrench, at its end."""

FEATURES = {
    "gravity": 0.3,
    "rotation": 3.0,
    "position": 2.0,
    "velocity": 0.5,
    "angular_velocity": 0.5,
    "force": 8.0,
    "moment": 8.0,
}
"""Factors `s` of what a policy observes, in the order of an observation."""

SCALE = np.repeat(list(FEATURES.values()), 3)


class Settings(tables.Table, frozen=True):
    """Settings of a training."""

    steps: tables.Count
    """Number of Adam steps."""
    batch: tables.Count = 16
    """Flights per step."""
    ticks: tables.Count = 100
    """Ticks per window."""
    learning_rate: tables.Positive = 3e-3
    """Initial learning rate, which falls to zero along half a cosine."""
    epsilon: tables.Positive = 0.01
    """Size of a gradient below which Adam's step shrinks with it: actions with hardly any effect stay near zero."""
    gradient_max: tables.Positive = 100.0
    """Length of a flight's gradient beyond which it is left out of a step."""
    hidden: tables.Count = 32
    """Width of the hidden layer."""


def init_policy(key: Key[Array, ""], action_size: int, hidden: int) -> Policy:
    """Return a policy whose actions are zero, with random weights of the hidden layer."""
    return Policy(
        jax.random.normal(key, (hidden, SCALE.size)) / np.sqrt(SCALE.size),
        jnp.zeros(hidden),
        jnp.zeros((action_size, hidden)),
        jnp.zeros((action_size, SCALE.size)),
        jnp.zeros(action_size),
    )


def act(xp: Any, policy: Policy, obs: Any) -> Any:
    """Return the action, between −1 and 1; `xp` is `numpy` or `jax.numpy`."""
    return evaluate(xp, policy, SCALE * xp.concatenate([obs[:BASE], obs[-WRENCH:]]))


def residual_of(policy: Policy, task: Task, jets: int) -> PolicyResidual:
    """Return the residual with which a controller flies the task, for a number of jets."""
    return PolicyResidual(
        policy, tuple(FEATURES), leaf(list(FEATURES.values())), leaf(task.thrust_rate), leaf(task.joint_velocity), jets
    )


class Curve(NamedTuple):
    """What was recorded of a step, for every seed."""

    reward: tuple[float, ...]
    """Mean reward of a tick."""
    left_out: tuple[int, ...]
    """Number of flights left out."""


class TrainingResult(NamedTuple):
    """Result of a training."""

    policies: Policy
    """One for each seed, stacked."""
    curves: tuple[Curve, ...]
    """Of every step."""

    def policy(self, number: int) -> Policy:
        """Return the policy of one seed, of NumPy arrays."""
        chosen: Policy = jax.tree.map(lambda leaf: np.asarray(leaf[number]), self.policies)
        return chosen


class _Flight(NamedTuple):
    state: EnvState
    age: Int[Array, ""]
    """Ticks of the episode; the first one begins with a greater age, so that episodes end at different times."""


@pytree
class _State:
    policy: Policy
    adam: AdamState
    flights: _Flight


def train(
    env: FlightEnv,
    settings: Settings,
    seeds: Sequence[int],
    *,
    checkpoint: Path,
    digest: str,
    checkpoint_every: int = 10,
    on_step: Callable[[int, Curve], None] = lambda *_: None,
) -> TrainingResult:
    """Train a policy for each seed, or resume from the checkpoint of this digest; in double precision if `env` is."""
    keys = jax.vmap(jax.random.key)(jnp.asarray(seeds))
    state: _State = jax.jit(jax.vmap(partial(_start, env, settings)))(keys)
    step, curves = 0, []
    if found := load_checkpoint(checkpoint, digest, state):
        state, step = found.state, found.facts["step"]
        curves = [Curve(*map(tuple, curve)) for curve in found.facts["curves"]]
    advance = jax.jit(
        jax.vmap(
            partial(_step, env, settings.ticks, settings.gradient_max, settings.epsilon), in_axes=(0, 0, None, None)
        ),
        compiler_options=COMPILER_OPTIONS,
    )
    while step < settings.steps:
        # An argument, so that runs of other lengths and rates share the compiled step.
        rate = settings.learning_rate * 0.5 * (1.0 + math.cos(math.pi * step / settings.steps))
        state, (reward, left_out) = advance(keys, state, jnp.asarray(step), jnp.asarray(rate))
        step += 1
        curves.append(Curve(tuple(reward.tolist()), tuple(left_out.tolist())))
        on_step(step, curves[-1])
        if step % checkpoint_every == 0 or step == settings.steps:
            save_checkpoint(checkpoint, digest, Checkpoint(state, {"step": step, "curves": curves}))
    return TrainingResult(state.policy, tuple(curves))


def _start(env: FlightEnv, settings: Settings, key: Array) -> _State:
    for_policy, for_flights = jax.random.split(key)
    policy = init_policy(for_policy, env.action_size, settings.hidden)
    flights = jax.vmap(partial(_begin, env))(jax.random.split(for_flights, settings.batch))
    age = jnp.arange(settings.batch, dtype=jnp.int32) * env.episode_length // settings.batch
    return _State(policy, adam_start(policy), flights._replace(age=age))


def _begin(env: FlightEnv, key: Array) -> _Flight:
    return _Flight(env.reset(key), jnp.zeros((), jnp.int32))


def _step(
    env: FlightEnv, ticks: int, gradient_max: float, epsilon: float, key: Array, state: _State, step: Array, rate: Array
) -> tuple[_State, tuple[Array, Array]]:
    """Fly one window of every flight of a seed, and improve its policy."""
    gradient_of = jax.vmap(jax.value_and_grad(partial(fly_window, env, ticks), has_aux=True), in_axes=(None, 0))
    (cost, flights), gradients = gradient_of(state.policy, state.flights)
    batch = cost.size
    square = sum(jnp.sum(leaf.reshape(batch, -1) ** 2, axis=1) for leaf in jax.tree.leaves(gradients))
    is_sound = jnp.sqrt(square) <= gradient_max  # false for NaN

    def mean(leaf: Array) -> Array:
        chosen = jnp.where(is_sound.reshape(-1, *[1] * (leaf.ndim - 1)), leaf, 0.0)
        return jnp.sum(chosen, axis=0) / jnp.maximum(jnp.sum(is_sound), 1)

    adam, policy = adam_step(state.adam, state.policy, jax.tree.map(mean, gradients), rate, epsilon=epsilon)
    keys = jax.random.split(jax.random.fold_in(key, step), batch)
    has_ended = (flights.state.done > 0.0) | (flights.age >= env.episode_length)
    flights = jax.vmap(where)(has_ended, jax.vmap(partial(_begin, env))(keys), flights)
    return _State(policy, adam, flights), (-jnp.mean(cost), jnp.sum(~is_sound))


def fly_window(env: FlightEnv, ticks: int, policy: Policy, flight: _Flight) -> tuple[Float[Array, ""], _Flight]:
    """Return the negative mean reward of the next ticks of a flight, and the flight after them."""

    def tick(state: EnvState, _: None) -> tuple[EnvState, Array]:
        state = env.step(state, act(jnp, policy, state.obs))
        return state, state.reward

    state, rewards = jax.lax.scan(tick, flight.state, length=ticks)
    return -jnp.mean(rewards), _Flight(state, flight.age + ticks)
