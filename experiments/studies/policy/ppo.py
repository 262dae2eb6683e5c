"""Proximal policy optimisation, batched in JAX: what gradients through the flight are compared with.

```text
A_k = Σ (γ λ)ⁱ δ_k+i,   δ_k = r_k + γ V(o_k+1) − V(o_k)                     until the flight is lost
cost = −mean min( ρ A, clip(ρ, 1 ± c) A ) + ½ mean (V − A − V₀)²,   ρ = π(a|o) / π₀(a|o)
```

Actions are normal about those of the policy, and limited by the environment; advantages are scaled to mean zero and
deviation one, observations by their running mean and deviation. Flights and their starts are those of
`jax_aero.train.policy`.

Source: Schulman et al. 2017, arXiv:1707.06347; advantages: Schulman et al., ICLR 2016.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jax_aero.base import tables
from jax_aero.control.law.residual import Policy, evaluate, weigh
from jax_aero.env import EnvState, FlightEnv
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.train.policy import Flight, Trainer, begin_all, begin_anew, counts, init_network
from jax_aero.types import Array, pytree

LARGEST = 10.0
"""Greatest scaled observation."""


class Settings(tables.Table, frozen=True):
    """Settings of a training."""

    steps: tables.Count
    """Number of windows."""
    batch: tables.Count = 64
    """Flights per window."""
    ticks: tables.Count = 64
    """Ticks per window."""
    epochs: tables.Count = 4
    """Passes over the ticks of a window."""
    parts: tables.Count = 8
    """Parts of a pass, each with a step of Adam."""
    learning_rate: tables.Positive = 3e-4
    """Initial learning rate, which falls to zero along half a cosine."""
    discount: tables.Positive = 0.995
    """`γ`."""
    trace: tables.Positive = 0.95
    """`λ`."""
    clip: tables.Positive = 0.2
    """`c`."""
    hidden: tuple[tables.Count, ...] = (64, 64)
    """Widths of the hidden layers, of policy and value."""
    deviation: tables.Positive = 0.3
    """Initial standard deviation of an action."""


class Learnt(NamedTuple):
    """What is learnt."""

    policy: Policy
    log_deviation: Float[Array, " u"]
    value: Policy


class Moments(NamedTuple):
    """What observations are scaled by."""

    mean: Float[Array, " o"]
    square: Float[Array, " o"]
    """Mean squared deviation."""
    number: Float[Array, ""]
    """Of observations."""

    def scale(self, obs: Float[Array, "*b o"]) -> Float[Array, "*b o"]:
        """Return observations with mean zero and deviation one, limited to `LARGEST`."""
        return jnp.clip((obs - self.mean) / jnp.sqrt(self.square + 1e-6), -LARGEST, LARGEST)

    def updated(self, obs: Float[Array, "n o"]) -> Moments:
        """Return the moments of these observations and those before."""
        mean, square, number = jnp.mean(obs, axis=0), jnp.var(obs, axis=0), self.number + obs.shape[0]
        share, apart = obs.shape[0] / number, mean - self.mean
        mixed = (1.0 - share) * self.square + share * square + share * (1.0 - share) * apart**2
        return Moments(self.mean + share * apart, mixed, number)


class Actor(NamedTuple):
    """The policy without noise, as `jax_aero.train.policy.Network` has its parameters."""

    policy: Policy
    moments: Moments


@dataclass(frozen=True)
class Normalised:
    """The network whose parameters are an `Actor`."""

    inputs: int
    hidden: tuple[int, ...]
    actions: int

    def init(self, key: Array) -> Actor:
        """Return initial parameters, whose actions are almost zero and of observations as they are."""
        policy = init_network(key, self.inputs, self.hidden, self.actions, 0.01)
        return Actor(policy, Moments(jnp.zeros(self.inputs), jnp.ones(self.inputs), jnp.zeros(())))

    def apply(self, parameters: Actor, obs: Float[Array, " o"]) -> Float[Array, " u"]:
        """Return the action of an observation."""
        action: Array = evaluate(jnp, parameters.policy, parameters.moments.scale(obs))
        return action


@pytree
class _State:
    learnt: Learnt
    moments: Moments
    adam: AdamState
    flights: Flight

    @property
    def parameters(self) -> Actor:
        """Return the policy without noise."""
        return Actor(self.learnt.policy, self.moments)


class Seen(NamedTuple):
    """What is seen in the ticks of a window (t, …)."""

    obs: Float[Array, "t o"]
    """Scaled, before the tick."""
    after: Float[Array, "t o"]
    """After it."""
    action: Float[Array, "t u"]
    reward: Float[Array, " t"]
    done: Float[Array, " t"]


class Sample(NamedTuple):
    """What is learnt from one tick."""

    obs: Float[Array, " o"]
    action: Float[Array, " u"]
    log_likelihood: Float[Array, ""]
    """Of the action, before the window is learnt from."""
    advantage: Float[Array, ""]
    target: Float[Array, ""]
    """Of the value."""
    weight: Float[Array, ""]
    """1 up to the loss of the flight, 0 after it."""


def network_of(env: FlightEnv, settings: Settings) -> Normalised:
    """Return the network that is trained."""
    return Normalised(env.observation_size, settings.hidden, env.action_size)


def trainer(env: FlightEnv, settings: Settings) -> Trainer:
    """Return the training of an environment by these settings."""
    return Trainer(settings.steps, partial(_start, env, settings), partial(_step, env, settings))


def _start(env: FlightEnv, settings: Settings, key: Array) -> _State:
    for_policy, for_value, for_flights = jax.random.split(key, 3)
    inputs, hidden = env.observation_size, settings.hidden
    learnt = Learnt(
        network_of(env, settings).init(for_policy).policy,
        jnp.full(env.action_size, jnp.log(settings.deviation)),
        init_network(for_value, inputs, hidden, 1, 0.1),
    )
    flights = begin_all(env, for_flights, settings.batch)
    # With the weight of a window, so that the first one does not move them all the way.
    about = flights.state.obs
    size = jnp.asarray(float(settings.batch * settings.ticks))
    moments = Moments(jnp.mean(about, axis=0), jnp.ones(inputs), size)
    return _State(learnt, moments, adam_start(learnt), flights)


def value_of(value: Policy, obs: Float[Array, " o"]) -> Float[Array, ""]:
    """Return the expected return of a scaled observation."""
    number: Array = weigh(jnp, value, obs)[0]
    return number


def _step(
    env: FlightEnv, settings: Settings, key: Array, state: _State, _number: Array, share: Array
) -> tuple[_State, tuple[Array, Array]]:
    """Fly one window of every flight, and learn from it."""
    for_noise, for_order, for_flights = jax.random.split(key, 3)
    keys = jax.random.split(for_noise, settings.batch)
    flights, seen, raw = jax.vmap(partial(_fly, env, settings, state.learnt, state.moments))(state.flights, keys)
    samples = jax.vmap(partial(_judge, settings, state.learnt))(seen)
    samples = samples._replace(advantage=_standard(samples.advantage, samples.weight))
    flat = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), samples)

    def improve(carry: tuple[AdamState, Learnt], chosen: Array) -> tuple[tuple[AdamState, Learnt], None]:
        adam, learnt = carry
        part = jax.tree.map(lambda leaf: leaf[chosen], flat)
        gradient = jax.grad(partial(_cost, settings))(learnt, part)
        return adam_step(adam, learnt, gradient, settings.learning_rate * share), None

    orders = jax.vmap(lambda key: jax.random.permutation(key, flat.weight.size))(
        jax.random.split(for_order, settings.epochs)
    )
    chosen = orders.reshape(settings.epochs * settings.parts, -1)
    (adam, learnt), _ = jax.lax.scan(improve, (state.adam, state.learnt), chosen)
    is_lost = jnp.max(seen.done, axis=1)
    moments = state.moments.updated(raw.reshape(-1, raw.shape[-1]))
    after = _State(learnt, moments, adam, begin_anew(env, for_flights, flights, is_lost))
    return after, (jnp.mean(seen.reward), jnp.mean(is_lost))


def _fly(
    env: FlightEnv, settings: Settings, learnt: Learnt, moments: Moments, flight: Flight, key: Array
) -> tuple[Flight, Seen, Float[Array, "t o"]]:
    """Fly the next ticks of a flight with noise on its actions; return what is observed before scaling, too."""
    deviation = jnp.exp(learnt.log_deviation)

    def tick(state: EnvState, key: Array) -> tuple[EnvState, tuple[Seen, Array]]:
        obs = moments.scale(state.obs)
        action = evaluate(jnp, learnt.policy, obs) + deviation * jax.random.normal(key, deviation.shape)
        after = env.step(state, action)
        return after, (Seen(obs, moments.scale(after.obs), action, after.reward, after.done), state.obs)

    state, (seen, raw) = jax.lax.scan(tick, flight.state, jax.random.split(key, settings.ticks))
    return Flight(state, flight.age + settings.ticks), seen, raw


def _judge(settings: Settings, learnt: Learnt, seen: Seen) -> Sample:
    """Return what is learnt from the ticks of a window."""
    now, later = (jax.vmap(partial(value_of, learnt.value))(obs) for obs in (seen.obs, seen.after))
    surprise = seen.reward + settings.discount * (1.0 - seen.done) * later - now

    def back(following: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        surprise, done = row
        advantage = surprise + settings.discount * settings.trace * (1.0 - done) * following
        return advantage, advantage

    advantage = jax.lax.scan(back, jnp.zeros(()), (surprise, seen.done), reverse=True)[1]
    likelihood = jax.vmap(partial(log_likelihood, learnt))(seen.obs, seen.action)
    return Sample(seen.obs, seen.action, likelihood, advantage, now + advantage, counts(seen.done))


def log_likelihood(learnt: Learnt, obs: Float[Array, " o"], action: Float[Array, " u"]) -> Float[Array, ""]:
    """Return that of an action, but for a constant."""
    from_mean = (action - evaluate(jnp, learnt.policy, obs)) * jnp.exp(-learnt.log_deviation)
    return -jnp.sum(0.5 * from_mean**2 + learnt.log_deviation)


def _cost(settings: Settings, learnt: Learnt, part: Sample) -> Array:
    ratio = jnp.exp(jax.vmap(partial(log_likelihood, learnt))(part.obs, part.action) - part.log_likelihood)
    limited = jnp.clip(ratio, 1.0 - settings.clip, 1.0 + settings.clip)
    gain = jnp.minimum(ratio * part.advantage, limited * part.advantage)
    error = jax.vmap(partial(value_of, learnt.value))(part.obs) - part.target
    return jnp.sum(part.weight * (0.5 * error**2 - gain)) / jnp.sum(part.weight)


def _standard(numbers: Array, weight: Array) -> Array:
    """Return numbers with mean zero and deviation one."""
    mean = jnp.sum(weight * numbers) / jnp.sum(weight)
    variance = jnp.sum(weight * (numbers - mean) ** 2) / jnp.sum(weight)
    return (numbers - mean) / (jnp.sqrt(variance) + 1e-6)
