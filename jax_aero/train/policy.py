"""Training of a policy by gradients through short flights: any environment, network, reward and curriculum.

```text
J = 1/n Σ r_k                                           of a window of n ticks, which begins where the last one ended
r = − ½ log(1 + 10 |φ + τ ω|²) − ½ log(1 + 20 |e + τ v|²) − 0.01 mean(a²)          the reward of training
```

with errors of attitude φ and position e, and their rates ω and v. Near the set-point, and for τ = 0, it is the reward
of the task (`env_task.rewards`) less one. That reward has no gradient far from the set-point, and in a window of less
than a second none for what a velocity will become: a policy that has learnt to stay for a second, but not to return,
then learns nothing more. The logarithm has one everywhere, and `e + τ v = 0` is an approach with time constant τ.

Inputs are measured from an observation of the robot at its set-point. Gravity and thrusts are not zero there, so that a
step of the weights would change the action by more than a step of the biases does.

Episodes of a batch end at different times; a flight begins anew when its episode ends or when it is lost. The gradient
of a flight that is about to be lost is larger by orders of magnitude, so each flight's is clipped; one that is not
finite, or so long that its direction is one of roundings, counts as zero. Rewards of windows flatter a policy, since
they begin where it has flown to: whole episodes judge it (`fly_episodes`).

>>> from jax_aero.env import FlightEnv, Task
>>> env = FlightEnv(Task(steering="rates", thrust_rate=200.0, joint_velocity=2.0), reward=approach())
>>> training = trainer(env, Settings(steps=300))              # network=..., curriculum=... for others
>>> found = training.train(0, checkpoint=Path("mine.part"))   # doctest: +SKIP

Source of the windows: short-horizon actor-critic, Xu et al., ICLR 2022, here without a critic.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key
from msgspec import structs
from numpy.typing import NDArray

from jax_aero.base import tables
from jax_aero.base.terminal import progress_bar
from jax_aero.control.law.residual import Layer, Policy, PolicyResidual, evaluate
from jax_aero.env_task import FEATURES, Observation, Reward, Task, TaskState
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jax_aero.types import Array, leaf, pytree, where

SCALE = {**dict.fromkeys(FEATURES, 3.0), "gravity": 9.0, "rotation": 15.0, "position": 6.0}
"""Factors `s` of what a policy observes: a robot that is about to be lost has some of them beyond 1."""

EPSILON = 1e-6
"""Size of a gradient below which Adam's steps shrink."""
CHAOTIC = 1e3
"""Length of a gradient, in units of that to which it is clipped, beyond which it is one of roundings: those of flights
that are lost, but whose motion is not chaotic, are shorter than 30."""


class Settings(tables.Table, frozen=True):
    """Settings of a training."""

    steps: tables.Count
    """Number of windows, each with a step of the policy."""
    batch: tables.Count = 16
    """Flights per step."""
    ticks: tables.Count = 64
    """Ticks per window."""
    learning_rate: tables.Positive = 3e-3
    """Initial learning rate, which falls to `least_rate` along half a cosine."""
    least_rate: tables.NonNegative = 1e-5
    gradient_max: tables.Positive = 1.0
    """Length to which a flight's gradient is clipped."""
    hidden: tuple[tables.Count, ...] = (64, 64)
    """Widths of the hidden layers of the standard network."""


def approach(ahead: float = 0.3) -> Reward:
    """Return the reward of training, with τ = `ahead` [s]."""

    def reward(xp: Any, state: TaskState, action: Any) -> dict[str, Any]:
        aim = state.aim
        error = xp.swapaxes(aim.rotation, -1, -2) @ state.rotation
        turned = 0.5 * xp.stack([error[..., i, j] - error[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
        turning = ((state.velocity[..., 3:6] - aim.angular_velocity)[..., None, :] @ state.rotation)[..., 0, :]
        moved = state.com - aim.com + ahead * (state.velocity[..., :3] - aim.velocity)
        return {
            "attitude": -0.5 * xp.log1p(10.0 * xp.sum((turned + ahead * turning) ** 2, axis=-1)),
            "position": -0.5 * xp.log1p(20.0 * xp.sum(moved**2, axis=-1)),
            "effort": -0.01 * xp.sum(action**2, axis=-1) / max(action.shape[-1], 1),
        }

    return reward


# --- networks


class Network(Protocol):
    """A policy to be trained: `apply` is differentiable in its parameters, which are any pytree of arrays."""

    def init(self, key: Key[Array, ""]) -> Any:
        """Return initial parameters."""

    def apply(self, parameters: Any, obs: Float[Array, " o"]) -> Float[Array, " u"]:
        """Return the action of an observation, between −1 and 1."""


def init_network(key: Key[Array, ""], inputs: int, hidden: Sequence[int], outputs: int, scale: float) -> Policy:
    """Return random weights, those of the output `scale` times as large, without a linear part."""
    widths = (inputs, *hidden, outputs)
    keys = jax.random.split(key, len(widths) - 1)
    *layers, output = (
        Layer(jax.random.normal(key, (end, start)) / math.sqrt(start), jnp.zeros(end))
        for key, start, end in zip(keys, widths[:-1], widths[1:], strict=True)
    )
    return Policy(tuple(layers), output._replace(weight=scale * output.weight), jnp.zeros((outputs, inputs)))


@dataclass(frozen=True)
class Perceptron:
    """The network of a card: hidden layers, and a linear part beside them, of `s ∘ (o − o₀)`."""

    centre: NDArray[np.floating]
    """`o₀`: the observation at the set-point."""
    scale: NDArray[np.float32]
    """`s`."""
    hidden: tuple[int, ...]
    actions: int

    def init(self, key: Key[Array, ""]) -> Policy:
        """Return initial parameters, whose actions are almost zero."""
        return init_network(key, self.scale.size, self.hidden, self.actions, 0.01)

    def apply(self, parameters: Policy, obs: Float[Array, " o"]) -> Float[Array, " u"]:
        """Return the action of an observation, between −1 and 1."""
        action: Array = evaluate(jnp, parameters, self.scale * (obs - self.centre))
        return action

    def to_policy(self, parameters: Policy) -> Policy:
        """Return the weights for `s ∘ o`, as in a card: `o₀` becomes a part of the biases."""
        return _moved(parameters, -self.scale * self.centre)

    def from_policy(self, policy: Policy) -> Policy:
        """Return the parameters of a card's weights: the inverse of `to_policy`, for a warm start."""
        return _moved(policy, self.scale * self.centre)


def _moved(policy: Policy, by: Any) -> Policy:
    """Return the policy of inputs that are less by `by`."""
    first = policy.hidden[0] if policy.hidden else policy.output
    first = first._replace(bias=first.bias + first.weight @ by)
    output = policy.output if policy.hidden else first
    hidden = (first, *policy.hidden[1:]) if policy.hidden else ()
    return Policy(hidden, output._replace(bias=output.bias + policy.direct @ by), policy.direct)


def perceptron(env: Any, hidden: Sequence[int] = (64, 64)) -> Perceptron:
    """Return the standard network for an environment."""
    centre = np.asarray(env.start(jnp.zeros(3), 0).obs)
    scale = (
        np.ones(centre.size, np.float32)
        if callable(env.observation)
        else scale_of(env.observation, env.jets, env.action_size)
    )
    return Perceptron(centre, scale, tuple(hidden), env.action_size)


def scale_of(names: Sequence[str], jets: int, actions: int) -> NDArray[np.float32]:
    """Return the factors of the numbers of an observation of these features."""
    return np.repeat([SCALE[name] for name in names], _sizes(names, jets, actions)).astype(np.float32)


def _sizes(names: Sequence[str], jets: int, actions: int) -> list[int]:
    sizes = {"thrust": jets, "joint_position": actions - jets, "joint_velocity": actions - jets}
    return [sizes.get(name, 3) for name in names]


def residual_of(policy: Any, task: Task, jets: int, names: Observation = FEATURES) -> PolicyResidual:
    """Return the residual with which a controller flies the task, for a number of jets and what is observed.

    Raises
    ------
    ValueError
        If what is observed are not names of features, or if the policy is not of the card's architecture.
    """
    if callable(names) or not isinstance(policy, Policy):
        given = "`observation` is a function" if callable(names) else f"the parameters are a {type(policy).__name__}"
        raise ValueError(f"{given}; expected names of features and a `Policy`, which are what a card holds")
    effects = leaf(task.thrust_rate), leaf(task.joint_velocity)
    scale = leaf([SCALE[name] for name in names])
    return PolicyResidual(policy, tuple(names), scale, *effects, jets, task.steering == "rates")


def warm_start(card: PolicyResidual, network: Perceptron, names: Sequence[str] = FEATURES) -> Policy:
    """Return the parameters with which a training of a perceptron goes on from a card, read by `load_policy`.

    Raises
    ------
    ValueError
        If the card observes other features, or has other widths.
    """
    policy = card.policy
    widths = tuple(layer.bias.size for layer in policy.hidden)
    for name, actual, expected in (
        ("features", tuple(card.features), tuple(names)),
        ("architecture.hidden", widths, network.hidden),
    ):
        if actual != expected:
            raise ValueError(f"`{name}` of the card is {list(actual)}; expected {list(expected)}")
    sizes = _sizes(names, card.jets, policy.output.bias.size)
    ratio = np.repeat(np.asarray(card.scale), sizes) / network.scale
    if policy.hidden:
        first, *others = policy.hidden
        policy = replace(policy, hidden=(first._replace(weight=first.weight * ratio), *others))
    else:
        policy = replace(policy, output=policy.output._replace(weight=policy.output.weight * ratio))
    return network.from_policy(replace(policy, direct=policy.direct * ratio))


# --- flights


class Flight(NamedTuple):
    """A flight of a batch."""

    state: Any
    """Of the environment."""
    age: Int[Array, ""]
    """Ticks of the episode; the first one begins with a greater age, so that episodes end at different times."""


def begin_all(env: Any, key: Key[Array, ""], batch: int) -> Flight:
    """Begin a batch of flights."""
    age = jnp.arange(batch, dtype=jnp.int32) * env.episode_length // batch
    return _begin(env, key, batch)._replace(age=age)


def begin_anew(env: Any, key: Key[Array, ""], flights: Flight, is_lost: Float[Array, " b"]) -> Flight:
    """Begin those flights of a batch anew that are lost or at their end."""
    has_ended = (is_lost > 0.0) | (flights.age >= env.episode_length)
    fresh: Flight = jax.vmap(where)(has_ended, _begin(env, key, has_ended.size), flights)
    return fresh


def _begin(env: Any, key: Array, batch: int) -> Flight:
    return Flight(jax.vmap(env.reset)(jax.random.split(key, batch)), jnp.zeros(batch, jnp.int32))


def fly_window(
    env: Any, network: Network, ticks: int, parameters: Any, flight: Flight
) -> tuple[Float[Array, ""], tuple[Flight, Float[Array, " t"], Float[Array, " t"]]]:
    """Return the negative mean reward of the next ticks of a flight; the flight after them, rewards and losses."""

    def tick(state: Any, _: None) -> tuple[Any, tuple[Array, Array]]:
        after = env.step(state, network.apply(parameters, state.obs))
        return after, (after.reward, after.done)

    state, (reward, done) = jax.lax.scan(jax.checkpoint(tick), flight.state, length=ticks)
    gain = jnp.sum(counts(done) * reward)
    return -gain / ticks, (Flight(state, flight.age + ticks), reward, done)


def counts(done: Float[Array, " t"]) -> Float[Array, " t"]:
    """Return 1 for ticks up to the loss of a flight, 0 after it."""
    return jnp.cumprod(jnp.concatenate([jnp.ones_like(done[:1]), 1.0 - done[:-1]]))


def fly_episodes(
    env: Any, network: Network, parameters: Any, winds: Float[Array, "b 3"], drawn: Int[Array, " b"]
) -> tuple[Float[Array, " b"], Float[Array, " b"]]:
    """Fly whole episodes; return the mean reward of a tick of each, zero once lost, and 1 for those that survive."""

    def fly(wind: Array, number: Array) -> tuple[Array, Array]:
        def tick(carry: tuple[Any, Array], _: None) -> tuple[tuple[Any, Array], Array]:
            state, flies = carry
            state = env.step(state, network.apply(parameters, state.obs))
            # The reward of the tick in which it is lost is zero already.
            return (state, flies * (1.0 - state.done)), flies * state.reward

        start = env.start(wind, number)
        (_, flies), rewards = jax.lax.scan(tick, (start, jnp.ones_like(wind[0])), length=env.episode_length)
        return jnp.mean(rewards), flies

    return jax.vmap(fly)(winds, drawn)


# --- training


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

    parameters: Any
    rows: tuple[Row, ...]
    """Of every step."""


Curriculum = Callable[[Any, Int[Array, ""]], Any]
"""Function from an environment and the number of a step, which is traced, to the environment of that step."""


class Trainer:
    """A training that goes on step by step, compiled once for all seeds.

    Parameters
    ----------
    steps
        Number of steps.
    start
        Function from a key to the state at the beginning, whose `parameters` are trained.
    step
        Function from a key, a state, the number of the step and the share of the learning rate to the next state, the
        mean reward of its ticks and the share of flights that were lost.
    of
        What `start` and `step` are made of, as far as a text can say it: a checkpoint of another one does not count.
    """

    def __init__(self, steps: int, start: Callable[..., Any], step: Callable[..., Any], of: str = "") -> None:
        self.steps, self._start, self._of = steps, jax.jit(start), of
        self._step = jax.jit(step, compiler_options=COMPILER_OPTIONS)

    def train(
        self,
        seed: int,
        *,
        checkpoint: Path | None = None,
        digest: str = "",
        start: Any = None,
        checkpoint_every: int = 25,
        on_step: Callable[[int, Any, list[Row]], None] = lambda *_: None,
    ) -> TrainingResult:
        """Train a policy.

        Parameters
        ----------
        seed
            Of the initial weights and the flights.
        checkpoint
            File from which a training resumes to the same numbers, and which stays when it has finished; `None` for
            none. One of another seed, task, setting (but for `steps`) or size of an array does not count.
        digest
            Text that names what is not compared, since it is functions or configurations: network, observation,
            reward, curriculum, `drawn`. A checkpoint with another text does not count.
        start
            Initial parameters in place of those of the network: a warm start.
        checkpoint_every
            Steps between two checkpoints.
        on_step
            Called with the number of finished steps, the parameters and what is recorded so far.
        """
        key, rows = jax.random.key(seed), list[Row]()
        state = self._start(key)
        if start is not None:
            state = replace(state, parameters=jax.tree.map(jnp.asarray, start))
        sizes = [jnp.shape(array) for array in jax.tree.leaves(state)]
        seal = f"{digest}; {self._of}; seed {seed}; {sizes}"
        if checkpoint is not None and (stored := load_checkpoint(checkpoint, seal, state)):
            state, rows = stored.state, [Row(*row) for row in stored.facts["rows"]]
        with progress_bar("step", f"seed {seed}", delay=0) as show:
            for number in range(len(rows), self.steps):
                show(number, self.steps)  # before the first step, which compiles for minutes
                began = time.process_time(), time.perf_counter()
                # Arguments, so that runs of other lengths share the compiled step.
                share = jnp.asarray(0.5 * (1.0 + math.cos(math.pi * number / self.steps)))
                state, recorded = self._step(jax.random.fold_in(key, number), state, jnp.asarray(number), share)
                reward, lost = map(float, recorded)  # waits for the step
                rows.append(Row(reward, lost, time.process_time() - began[0], time.perf_counter() - began[1]))
                on_step(number + 1, state.parameters, rows)
                is_due = (number + 1) % checkpoint_every == 0 or number + 1 == self.steps
                if checkpoint is not None and is_due:
                    save_checkpoint(checkpoint, seal, Checkpoint(state, {"rows": rows}))
        return TrainingResult(jax.tree.map(np.asarray, state.parameters), tuple(rows))


@pytree
class _State:
    parameters: Any
    adam: AdamState
    flights: Flight


def trainer(
    env: Any, settings: Settings, network: Network | None = None, curriculum: Curriculum = lambda env, _: env
) -> Trainer:
    """Return the training of an environment by gradients through its flights.

    Parameters
    ----------
    env
        A `FlightEnv`, or another environment of pure functions with its `start`, `reset` and `step`.
    settings
        Of the training.
    network
        What is trained; `None` for the `perceptron` that a card can hold.
    curriculum
        Function from the environment and the traced number of a step to the environment of that step, such as
        `lambda env, step: env.at(wind_max=jnp.minimum(12.0, 0.1 * step))`.
    """
    network = network or perceptron(env, settings.hidden)
    of = env, network, settings, curriculum
    named = f"{getattr(env, 'task', None)}; {structs.replace(settings, steps=1)}"
    return Trainer(settings.steps, partial(_start, *of), partial(_step, *of), named)


def _start(env: Any, network: Network, settings: Settings, curriculum: Curriculum, key: Array) -> _State:
    for_policy, for_flights = jax.random.split(key)
    parameters = network.init(for_policy)
    flights = begin_all(curriculum(env, jnp.zeros((), jnp.int32)), for_flights, settings.batch)
    return _State(parameters, adam_start(parameters), flights)


def _step(
    env: Any,
    network: Network,
    settings: Settings,
    curriculum: Curriculum,
    key: Array,
    state: _State,
    number: Array,
    share: Array,
) -> tuple[_State, tuple[Array, Array]]:
    """Fly one window of every flight; improve the policy."""
    env = curriculum(env, number)
    of_flight = jax.value_and_grad(partial(fly_window, env, network, settings.ticks), has_aux=True)
    (_, (flights, reward, done)), gradients = jax.vmap(of_flight, in_axes=(None, 0))(state.parameters, state.flights)
    gradient = jax.tree.map(partial(jnp.mean, axis=0), clip_each(gradients, settings.gradient_max))
    rate = settings.learning_rate * share + settings.least_rate
    adam, parameters = adam_step(state.adam, state.parameters, gradient, rate, epsilon=EPSILON)
    is_lost = jnp.max(done, axis=1)
    after = _State(parameters, adam, begin_anew(env, key, flights, is_lost))
    return after, (jnp.mean(reward), jnp.mean(is_lost))


def clip_each(gradients: Any, longest: float) -> Any:
    """Return the gradients of a batch, each no longer than `longest`, or zero where it is chaotic or not finite."""
    square = sum(jnp.sum(leaf.reshape(len(leaf), -1) ** 2, axis=1) for leaf in jax.tree.leaves(gradients))
    length = jnp.sqrt(square)
    share = jnp.where(length < CHAOTIC * longest, jnp.minimum(1.0, longest / jnp.maximum(length, 1e-9)), 0.0)

    def clip(leaf: Array) -> Array:
        of_leaf = share.reshape(-1, *[1] * (leaf.ndim - 1))
        return jnp.where(of_leaf > 0.0, leaf, 0.0) * of_leaf

    return jax.tree.map(clip, gradients)
