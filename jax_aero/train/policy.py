"""Training of a policy (`control.law.residual`) by gradients through short flights, with a learnt value beyond them.

```text
J = 1/n ( Σ γᵏ r_k + γⁿ V(o_n) )                        of a window of n ticks, which begins where the last one ended
V(o_k) → r_k + γ ( (1 − λ) V'(o_k+1) + λ target_k+1 )   with V' a slow copy of V
```

Episodes of a batch end at different times; a flight begins anew when its episode ends or when it is lost. The gradient
of a flight that is about to be lost is larger by orders of magnitude, so each flight's is clipped; one that is not
finite counts as zero. Rewards of windows flatter a policy, since they begin where it has flown to: whole episodes judge
it (`fly_episodes`).

Source: short-horizon actor-critic, Xu et al., ICLR 2022.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key
from numpy.typing import NDArray

from jax_aero.base import tables
from jax_aero.base.terminal import progress_bar
from jax_aero.control.law.residual import Layer, Policy, PolicyResidual, evaluate, weigh
from jax_aero.env import EnvState, FlightEnv, Task
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jax_aero.types import Array, leaf, pytree, where

BASE = {"gravity": 3.0, "rotation": 5.0, "position": 2.0, "velocity": 1.0, "angular_velocity": 1.0}
JOINTS = {"joint_position": 1.0, "joint_velocity": 1.0}
FEATURES = {**BASE, **JOINTS, "thrust": 1.0, "force": 1.0, "moment": 1.0}
"""Factors `s` of what a policy observes, in the order of an observation."""

VALUE_EPSILON, POLICY_EPSILON = 1e-8, 1e-6
"""Sizes of gradients below which Adam's steps shrink."""


class Settings(tables.Table, frozen=True):
    """Settings of a training."""

    steps: tables.Count
    """Number of windows, each with a step of the policy."""
    batch: tables.Count = 64
    """Flights per step."""
    ticks: tables.Count = 64
    """Ticks per window."""
    learning_rate: tables.Positive = 3e-3
    """Initial learning rate, which falls to `least_rate` along half a cosine."""
    least_rate: tables.NonNegative = 1e-5
    gradient_max: tables.Positive = 1.0
    """Length to which a flight's gradient is clipped."""
    hidden: tuple[tables.Count, ...] = (64, 64)
    """Widths of the hidden layers, of policy and value."""
    discount: tables.Positive = 0.995
    """`γ`."""
    trace: tables.Positive = 0.95
    """`λ`."""
    value_rate: tables.Positive = 1e-3
    """Learning rate of the value."""
    value_steps: tables.Count = 16
    """Its steps in a window."""
    value_share: tables.Positive = 0.2
    """Share of the way to the value that its slow copy goes in a window."""
    is_linear: bool = True
    """Whether the policy has a linear part."""
    has_value: bool = True
    """Whether the return counts the value at the end of a window."""


def init_network(key: Key[Array, ""], inputs: int, hidden: Sequence[int], outputs: int, scale: float) -> Policy:
    """Return random weights, those of the output `scale` times as large, without a linear part."""
    widths = (inputs, *hidden, outputs)
    keys = jax.random.split(key, len(widths) - 1)
    *layers, output = (
        Layer(jax.random.normal(key, (end, start)) / math.sqrt(start), jnp.zeros(end))
        for key, start, end in zip(keys, widths[:-1], widths[1:], strict=True)
    )
    return Policy(tuple(layers), output._replace(weight=scale * output.weight), jnp.zeros((outputs, inputs)))


def scale_of(observations: int, actions: int) -> NDArray[np.float32]:
    """Return the factors of the numbers of an observation, from the sizes of observation and action."""
    joints = observations - 21 - actions
    sizes = [{"thrust": actions - joints}.get(name, joints if name in JOINTS else 3) for name in FEATURES]
    return np.repeat(list(FEATURES.values()), sizes).astype(np.float32)


def act(xp: Any, policy: Policy, obs: Any) -> Any:
    """Return the action, between −1 and 1; `xp` is `numpy` or `jax.numpy`."""
    return evaluate(xp, policy, scale_of(obs.shape[-1], policy.output.bias.shape[-1]) * obs)


def residual_of(policy: Policy, task: Task, jets: int) -> PolicyResidual:
    """Return the residual with which a controller flies the task, for a number of jets."""
    effects = leaf(task.thrust_rate), leaf(task.joint_velocity)
    replaces = task.steering == "rates"
    return PolicyResidual(policy, tuple(FEATURES), leaf(list(FEATURES.values())), *effects, jets, replaces)


class Flight(NamedTuple):
    """A flight of a batch."""

    state: EnvState
    age: Int[Array, ""]
    """Ticks of the episode; the first one begins with a greater age, so that episodes end at different times."""


def begin_all(env: FlightEnv, key: Key[Array, ""], batch: int) -> Flight:
    """Begin a batch of flights."""
    age = jnp.arange(batch, dtype=jnp.int32) * env.episode_length // batch
    return _begin(env, key, batch)._replace(age=age)


def begin_anew(env: FlightEnv, key: Key[Array, ""], flights: Flight, is_lost: Float[Array, " b"]) -> Flight:
    """Begin those flights of a batch anew that are lost or at their end."""
    has_ended = (is_lost > 0.0) | (flights.age >= env.episode_length)
    fresh: Flight = jax.vmap(where)(has_ended, _begin(env, key, has_ended.size), flights)
    return fresh


def _begin(env: FlightEnv, key: Array, batch: int) -> Flight:
    return Flight(jax.vmap(env.reset)(jax.random.split(key, batch)), jnp.zeros(batch, jnp.int32))


class Row(NamedTuple):
    """What is recorded of a step."""

    reward: float
    """Mean reward of a tick of its windows."""
    lost: float
    """Share of flights that were lost."""
    processor: float
    """Processor time [s]; the first one of a process includes compilation."""
    wall: float
    """[s]"""


class TrainingResult(NamedTuple):
    """Result of a training."""

    policy: Policy
    rows: tuple[Row, ...]
    """Of every step."""


@pytree
class _State:
    policy: Policy
    value: Policy
    slow: Policy
    policy_adam: AdamState
    value_adam: AdamState
    flights: Flight


class Trainer:
    """A training that goes on step by step, compiled once for all seeds.

    Parameters
    ----------
    steps
        Number of steps.
    start
        Function from a key to the state at the beginning, whose `policy` is trained.
    step
        Function from a key, a state and the share of the learning rate to the next state, the mean reward of its ticks
        and the share of flights that were lost.
    """

    def __init__(self, steps: int, start: Callable[..., Any], step: Callable[..., Any]) -> None:
        self.steps, self._start = steps, jax.jit(start)
        self._step = jax.jit(step, compiler_options=COMPILER_OPTIONS)

    def train(
        self,
        seed: int,
        *,
        checkpoint: Path,
        digest: str,
        checkpoint_every: int = 25,
        on_step: Callable[[int, Policy, list[Row]], None] = lambda *_: None,
    ) -> TrainingResult:
        """Train a policy, or resume from the checkpoint of this digest."""
        key, rows = jax.random.key(seed), list[Row]()
        state = self._start(key)
        if found := load_checkpoint(checkpoint, digest, state):
            state, rows = found.state, [Row(*row) for row in found.facts["rows"]]
        with progress_bar("step", f"seed {seed}", delay=0) as show:
            for number in range(len(rows), self.steps):
                show(number, self.steps)  # before the first step, which compiles for minutes
                began = time.process_time(), time.perf_counter()
                # An argument, so that runs of other lengths share the compiled step.
                share = jnp.asarray(0.5 * (1.0 + math.cos(math.pi * number / self.steps)))
                state, recorded = self._step(jax.random.fold_in(key, number), state, share)
                reward, lost = map(float, recorded)  # waits for the step
                rows.append(Row(reward, lost, time.process_time() - began[0], time.perf_counter() - began[1]))
                on_step(number + 1, state.policy, rows)
                if (number + 1) % checkpoint_every == 0 or number + 1 == self.steps:
                    save_checkpoint(checkpoint, digest, Checkpoint(state, {"rows": rows}))
        return TrainingResult(jax.tree.map(np.asarray, state.policy), tuple(rows))


def trainer(env: FlightEnv, settings: Settings) -> Trainer:
    """Return the training of an environment by these settings."""
    return Trainer(settings.steps, partial(_start, env, settings), partial(_step, env, settings))


def _start(env: FlightEnv, settings: Settings, key: Array) -> _State:
    for_policy, for_value, for_flights = jax.random.split(key, 3)
    inputs, hidden = env.observation_size, settings.hidden
    policy = init_network(for_policy, inputs, hidden, env.action_size, 0.01)
    value = init_network(for_value, inputs, hidden, 1, 0.1)
    flights = begin_all(env, for_flights, settings.batch)
    return _State(policy, value, value, adam_start(policy), adam_start(value), flights)


class Seen(NamedTuple):
    """What is seen in the ticks of a window (t, …)."""

    obs: Float[Array, "t o"]
    """Scaled, before the tick."""
    after: Float[Array, "t o"]
    """After it."""
    reward: Float[Array, " t"]
    done: Float[Array, " t"]


def counts(done: Float[Array, " t"]) -> Float[Array, " t"]:
    """Return 1 for ticks up to the loss of a flight, 0 after it."""
    return jnp.cumprod(jnp.concatenate([jnp.ones_like(done[:1]), 1.0 - done[:-1]]))


def value_of(value: Policy, obs: Float[Array, " o"]) -> Float[Array, ""]:
    """Return the expected return of a scaled observation."""
    number: Array = weigh(jnp, value, obs)[0]
    return number


def _step(
    env: FlightEnv, settings: Settings, key: Array, state: _State, share: Array
) -> tuple[_State, tuple[Array, Array]]:
    """Fly one window of every flight; improve policy and value."""
    scale = jnp.asarray(scale_of(env.observation_size, env.action_size))
    of_flight = jax.value_and_grad(partial(fly_window, env, settings, scale), has_aux=True)
    gradient_of = jax.vmap(of_flight, in_axes=(None, None, 0))
    (_, (flights, seen)), gradients = gradient_of(state.policy, state.slow, state.flights)
    gradient = jax.tree.map(partial(jnp.mean, axis=0), clip_each(gradients, settings.gradient_max))
    if not settings.is_linear:
        gradient = jax.tree.map(jnp.multiply, gradient, _without_linear(gradient))
    rate = settings.learning_rate * share + settings.least_rate
    adam, policy = adam_step(state.policy_adam, state.policy, gradient, rate, epsilon=POLICY_EPSILON)
    value_adam, value = _learn_value(settings, state, seen)
    slow = jax.tree.map(lambda old, new: old + settings.value_share * (new - old), state.slow, value)
    is_lost = jnp.max(seen.done, axis=1)
    flights = begin_anew(env, key, flights, is_lost)
    after = _State(policy, value, slow, adam, value_adam, flights)
    return after, (jnp.mean(seen.reward), jnp.mean(is_lost))


def fly_window(
    env: FlightEnv, settings: Settings, scale: Float[Array, " o"], policy: Policy, slow: Policy, flight: Flight
) -> tuple[Float[Array, ""], tuple[Flight, Seen]]:
    """Return the negative return of the next ticks of a flight over their number, the flight after them, and them."""

    def tick(state: EnvState, _: None) -> tuple[EnvState, Seen]:
        obs = scale * state.obs
        after = env.step(state, evaluate(jnp, policy, obs))
        return after, Seen(obs, scale * after.obs, after.reward, after.done)

    state, seen = jax.lax.scan(jax.checkpoint(tick), flight.state, length=settings.ticks)
    discount = settings.discount ** jnp.arange(settings.ticks)
    gain = jnp.sum(discount * counts(seen.done) * seen.reward)
    if settings.has_value:
        survives = jnp.prod(1.0 - seen.done)
        gain += settings.discount**settings.ticks * survives * value_of(slow, seen.after[-1])
    return -gain / settings.ticks, (Flight(state, flight.age + settings.ticks), seen)


def clip_each(gradients: Any, longest: float) -> Any:
    """Return the gradients of a batch, each no longer than `longest`, or zero where it is not finite."""
    square = sum(jnp.sum(leaf.reshape(len(leaf), -1) ** 2, axis=1) for leaf in jax.tree.leaves(gradients))
    length = jnp.sqrt(square)
    share = jnp.where(jnp.isfinite(length), jnp.minimum(1.0, longest / jnp.maximum(length, 1e-9)), 0.0)

    def clip(leaf: Array) -> Array:
        of_leaf = share.reshape(-1, *[1] * (leaf.ndim - 1))
        return jnp.where(of_leaf > 0.0, leaf, 0.0) * of_leaf

    return jax.tree.map(clip, gradients)


def _learn_value(settings: Settings, state: _State, seen: Seen) -> tuple[AdamState, Policy]:
    """Fit the value to the targets of a batch of windows."""
    beyond = jax.vmap(jax.vmap(partial(value_of, state.slow)))(seen.after)
    targets = jax.vmap(partial(trace_back, settings))(seen.reward, seen.done, beyond)
    weight = jax.vmap(counts)(seen.done)

    def error(value: Policy) -> Array:
        found = jax.vmap(jax.vmap(partial(value_of, value)))(seen.obs)
        return jnp.sum(weight * (found - targets) ** 2) / jnp.sum(weight)

    def fit(carry: tuple[AdamState, Policy], _: None) -> tuple[tuple[AdamState, Policy], None]:
        adam, value = carry
        rate = jnp.asarray(settings.value_rate)
        return adam_step(adam, value, jax.grad(error)(value), rate, epsilon=VALUE_EPSILON), None

    return jax.lax.scan(fit, (state.value_adam, state.value), length=settings.value_steps)[0]


def trace_back(
    settings: Settings, reward: Float[Array, " t"], done: Float[Array, " t"], beyond: Float[Array, " t"]
) -> Float[Array, " t"]:
    """Return the targets of the value in a window, from the values after its ticks: TD(λ)."""

    def back(later: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        reward, done, value = row
        mixed = (1.0 - settings.trace) * value + settings.trace * later
        target = reward + settings.discount * (1.0 - done) * mixed
        return target, target

    targets: Array = jax.lax.scan(back, beyond[-1], (reward, done, beyond), reverse=True)[1]
    return targets


def _without_linear(policy: Policy) -> Policy:
    """Return ones, and zeros for the linear part."""
    ones = jax.tree.map(jnp.ones_like, policy)
    return Policy(ones.hidden, ones.output, jnp.zeros_like(policy.direct))


def fly_episodes(
    env: FlightEnv, policy: Policy, winds: Float[Array, "b 3"], drawn: Int[Array, " b"]
) -> tuple[Float[Array, " b"], Float[Array, " b"]]:
    """Fly whole episodes; return the mean reward of a tick of each, zero once lost, and 1 for those that survive."""

    def fly(wind: Array, number: Array) -> tuple[Array, Array]:
        def tick(carry: tuple[EnvState, Array], _: None) -> tuple[tuple[EnvState, Array], Array]:
            state, flies = carry
            state = env.step(state, act(jnp, policy, state.obs))
            # The reward of the tick in which it is lost is zero already.
            return (state, flies * (1.0 - state.done)), flies * state.reward

        start = env.start(wind, number)
        (_, flies), rewards = jax.lax.scan(tick, (start, jnp.ones_like(wind[0])), length=env.episode_length)
        return jnp.mean(rewards), flies

    return jax.vmap(fly)(winds, drawn)
