"""Training of policies, on a mass in place of a robot: what is learnt, clipped, begun anew and resumed."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.train import policy
from jax_aero.train.policy import Settings, act, init_network, trainer

SETTINGS = Settings(steps=60, batch=8, ticks=20, learning_rate=0.03, hidden=(4, 4), value_steps=2)


class Mass(NamedTuple):
    position: Any
    push: Any
    tick: Any
    obs: Any
    reward: Any
    done: Any


class Spring:
    """A damped mass on a spring, pushed by a constant force; lost beyond 1.5 m. It has one jet and one joint."""

    action_size, observation_size, dt, episode_length = 2, 24, 0.05, 60

    def reset(self, key):
        return self.start(jax.random.uniform(key, (3,), minval=-1.0, maxval=1.0), 0)

    def start(self, wind, _):
        zero = jnp.zeros(())
        return Mass(zero, wind[0], jnp.zeros((), jnp.int32), jnp.zeros(24), zero, zero)

    def step(self, state, action):
        position = state.position + self.dt * (3.0 * action[0] + state.push - 2.0 * state.position)
        obs = jnp.zeros(24).at[6].set(position).at[18].set(state.push)
        lost = jnp.abs(position) > 1.5
        reward = jnp.where(lost, 0.0, jnp.exp(-20.0 * position**2))
        return Mass(position, state.push, state.tick + 1, obs, reward, lost.astype(position.dtype))


def train(settings, seed, folder, env=None, **given):
    return trainer(env or Spring(), settings).train(seed, checkpoint=folder / "c", digest="a", **given)


def test_numpy_and_jax_have_the_same_actions():
    rng = np.random.default_rng(0)
    fresh = init_network(jax.random.key(1), 24, (4, 3), 2, 1.0)
    drawn = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape).astype(np.float32), fresh)
    obs = rng.normal(size=24).astype(np.float32)
    np.testing.assert_allclose(act(np, drawn, obs), act(jnp, drawn, obs), rtol=1e-5)


def test_every_number_of_an_observation_has_the_factor_of_its_feature():
    """Of two joints and three jets."""
    scale = policy.scale_of(28, 5)
    assert scale[:15].tolist() == np.repeat([3.0, 5.0, 2.0, 1.0, 1.0], 3).tolist()
    assert scale[15:].tolist() == [1.0] * 13


def test_training_holds_a_mass_against_a_force(tmp_path):
    """By whole episodes in forces of its own; without the linear part that stays zero."""
    winds, numbers = jnp.array([[-0.9, 0.0, 0.0], [0.9, 0.0, 0.0]]), jnp.zeros(2, jnp.int32)
    found = train(SETTINGS, 0, tmp_path)
    assert len(found.rows) == 60
    rewards, survived = policy.fly_episodes(Spring(), found.policy, winds, numbers)
    nothing = jax.tree.map(jnp.zeros_like, found.policy)
    without, _ = policy.fly_episodes(Spring(), nothing, winds, numbers)
    assert (rewards > without + 0.3).all()
    assert survived.tolist() == [1.0, 1.0]
    assert np.any(found.policy.direct)
    assert not np.any(train(Settings(steps=2, batch=2, ticks=5, is_linear=False), 0, tmp_path / "b").policy.direct)


def test_an_episode_counts_until_it_is_lost():
    """An action of 1 takes the mass beyond 1.5 m for good; of 60 ticks it earns what it had before."""
    pushing = init_network(jax.random.key(1), 24, (2,), 2, 0.0)
    pushing = policy.Policy(pushing.hidden, pushing.output._replace(bias=jnp.array([9.0, 0.0])), pushing.direct)
    (reward,), (survived,) = policy.fly_episodes(Spring(), pushing, jnp.array([[0.9, 0.0, 0.0]]), jnp.zeros(1, int))
    position, earned = 0.0, 0.0
    while (position := position + 0.05 * (3.0 + 0.9 - 2.0 * position)) <= 1.5:
        earned += np.exp(-20.0 * position**2)
    assert survived == 0.0
    assert float(reward) == pytest.approx(earned / 60, rel=1e-5)


def test_a_run_that_is_stopped_goes_on_to_the_same_numbers(tmp_path):
    settings = Settings(steps=6, batch=2, ticks=5, hidden=(2,))
    whole = train(settings, 3, tmp_path / "whole")

    def stop(step, *_):
        if step == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(settings, 3, tmp_path, checkpoint_every=2, on_step=stop)
    after = []
    again = train(settings, 3, tmp_path, checkpoint_every=2, on_step=lambda step, *_: after.append(step))
    assert after == [5, 6]
    assert [row[:2] for row in again.rows] == [row[:2] for row in whole.rows]
    assert jax.tree.all(jax.tree.map(np.array_equal, again.policy, whole.policy))


def test_gradients_are_clipped_flight_by_flight():
    """The second is long, the third is not finite."""
    gradients = {"a": jnp.array([[0.3], [3.0], [jnp.nan]]), "b": jnp.array([[[0.4]], [[4.0]], [[1.0]]])}
    clipped = policy.clip_each(gradients, 1.0)
    np.testing.assert_allclose(clipped["a"].ravel(), [0.3, 0.6, 0.0], rtol=1e-6)
    np.testing.assert_allclose(clipped["b"].ravel(), [0.4, 0.8, 0.0], rtol=1e-6)


@pytest.mark.parametrize("trace", [0.3, 1.0])
def test_targets_of_the_value(trace):
    """Three ticks, the last of which is followed by a value of 7; in the second one a flight may be lost."""
    settings = Settings(steps=1, discount=0.9, trace=trace)
    reward, beyond = np.array([1.0, 2.0, 3.0]), np.array([5.0, 6.0, 7.0])
    last = 3.0 + 0.9 * 7.0
    middle = 2.0 + 0.9 * ((1.0 - trace) * 6.0 + trace * last)
    for lost, second in ((0.0, middle), (1.0, 2.0)):
        found = policy.trace_back(settings, *map(jnp.asarray, (reward, np.array([0.0, lost, 0.0]), beyond)))
        first = 1.0 + 0.9 * ((1.0 - trace) * 5.0 + trace * second)
        np.testing.assert_allclose(found, [first, second, last], rtol=1e-5)


@pytest.mark.parametrize("has_value", [True, False])
def test_a_window_counts_rewards_until_the_loss_and_the_value_beyond_its_end(has_value):
    settings = Settings(steps=1, ticks=2, discount=0.5, has_value=has_value)
    still = init_network(jax.random.key(1), 24, (2,), 2, 0.0)
    value = init_network(jax.random.key(1), 24, (2,), 1, 0.0)
    value = policy.Policy(value.hidden, value.output._replace(bias=jnp.array([8.0])), value.direct)
    flight = policy.Flight(Spring().start(jnp.zeros(3), 0), jnp.zeros((), jnp.int32))
    cost, (after, _) = policy.fly_window(Spring(), settings, jnp.ones(24), still, value, flight)
    assert float(cost) == pytest.approx(-(1.0 + 0.5 + (0.25 * 8.0 if has_value else 0.0)) / 2, rel=1e-6)
    assert (int(after.age), int(after.state.tick)) == (2, 2)
    lost = policy.Flight(flight.state._replace(position=jnp.array(9.0)), flight.age)
    assert float(policy.fly_window(Spring(), settings, jnp.ones(24), still, value, lost)[0]) == 0.0


def test_episodes_end_at_different_times_and_begin_anew():
    flights = policy.begin_all(Spring(), jax.random.key(0), 3)
    assert flights.age.tolist() == [0, 20, 40]
    flown = policy.Flight(flights.state._replace(tick=flights.state.tick + 20), flights.age + 20)
    after = policy.begin_anew(Spring(), jax.random.key(1), flown, jnp.array([1.0, 0.0, 0.0]))
    # The first was lost, the third's episode is over.
    assert after.age.tolist() == [0, 40, 0]
    assert after.state.tick.tolist() == [0, 20, 0]
    assert after.state.push[0] != flights.state.push[0]
    assert after.state.push[1] == flights.state.push[1]
