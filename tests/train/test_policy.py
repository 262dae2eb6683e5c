"""Training of policies, on a mass in place of a robot: what is learnt, left out, begun anew and resumed."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.train import policy
from jax_aero.train.policy import Settings, act, train

pytestmark = pytest.mark.usefixtures("x64")

SETTINGS = Settings(steps=40, batch=4, ticks=20, learning_rate=0.03, hidden=4)


class Mass(NamedTuple):
    position: Any
    push: Any
    tick: Any
    obs: Any
    reward: Any
    done: Any


class Spring:
    """A damped mass on a spring, pushed by a constant force; lost beyond 1.5 m."""

    action_size, dt, episode_length = 2, 0.05, 60

    def reset(self, key):
        zero = jnp.zeros(())
        push = jax.random.uniform(key, (), minval=-1.0, maxval=1.0)
        return Mass(zero, push, jnp.zeros((), jnp.int32), jnp.zeros(21), zero, zero)

    def step(self, state, action):
        position = state.position + self.dt * (3.0 * action[0] + state.push - 2.0 * state.position)
        obs = jnp.zeros(21).at[6].set(position).at[15].set(state.push)
        lost = jnp.abs(position) > 1.5
        reward = jnp.where(lost, 0.0, jnp.exp(-20.0 * position**2))
        return Mass(position, state.push, state.tick + 1, obs, reward, lost.astype(float))


def rewards(curves):
    return np.array([curve.reward for curve in curves])


def test_a_policy_without_training_does_nothing():
    fresh = policy.init_policy(jax.random.key(1), 2, 4)
    assert act(np, fresh, np.ones(30)).tolist() == [0.0, 0.0]


def test_numpy_and_jax_have_the_same_actions():
    rng = np.random.default_rng(0)
    drawn = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape), policy.init_policy(jax.random.key(1), 2, 4))
    obs = rng.normal(size=30)
    np.testing.assert_allclose(act(np, drawn, obs), act(jnp, drawn, obs), rtol=1e-13)
    # The joints, in the middle, are not used.
    assert np.array_equal(act(np, drawn, obs), act(np, drawn, np.concatenate([obs[:15], np.ones(40), obs[-6:]])))


def test_training_holds_a_mass_against_a_force(tmp_path):
    """And every seed draws its own forces."""
    found = train(Spring(), SETTINGS, (0, 1), checkpoint=tmp_path / "c", digest="a")
    course = rewards(found.curves)
    assert course.shape == (40, 2)
    assert np.all(course[-10:].mean(axis=0) > course[:10].mean(axis=0) + 0.1)
    assert course[-1, 0] != course[-1, 1]
    assert found.policies.hidden.shape == (2, 4, 21)


def test_a_run_that_is_stopped_goes_on_to_the_same_numbers(tmp_path):
    settings = Settings(steps=6, batch=2, ticks=5, hidden=2)
    whole = train(Spring(), settings, (3,), checkpoint=tmp_path / "whole", digest="a")

    def stop(step, _):
        if step == 5:
            raise KeyboardInterrupt

    where = {"checkpoint": tmp_path / "c", "digest": "a", "checkpoint_every": 2}
    with pytest.raises(KeyboardInterrupt):
        train(Spring(), settings, (3,), **where, on_step=stop)
    after = []
    again = train(Spring(), settings, (3,), **where, on_step=lambda step, _: after.append(step))
    assert after == [5, 6]
    assert again.curves == whole.curves
    assert jax.tree.all(jax.tree.map(np.array_equal, again.policies, whole.policies))


def test_flights_without_a_usable_gradient_are_left_out(tmp_path):
    class Broken(Spring):
        def step(self, state, action):
            """The gradient of every flight that is pushed forwards is not finite."""
            after = super().step(state, action)
            broken = jnp.sqrt(0.0 * jnp.sum(action)) * 0.0
            return after._replace(reward=after.reward + jnp.where(state.push > 0.0, broken, 0.0))

    settings = Settings(steps=3, batch=8, ticks=5, hidden=2)
    found = train(Broken(), settings, (0,), checkpoint=tmp_path / "c", digest="a")
    assert all(0 < curve.left_out[0] <= 8 for curve in found.curves)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found.policies))


def test_episodes_end_at_different_times_and_begin_anew():
    env, settings = Spring(), Settings(steps=1, batch=3, ticks=20, hidden=2)
    state = policy._start(env, settings, jax.random.key(0))
    assert state.flights.age.tolist() == [0, 20, 40]
    key, zero, rate = jax.random.key(0), jnp.asarray(0), jnp.asarray(0.01)
    step = jax.jit(lambda state: policy._step(env, 20, 100.0, 0.01, key, state, zero, rate)[0])
    lost = state.flights.state._replace(position=jnp.array([99.0, 0.0, 0.0]))
    after = step(policy._State(state.policy, state.adam, state.flights._replace(state=lost)))
    # The first was lost, the third's episode is over.
    assert after.flights.age.tolist() == [0, 40, 0]
    assert after.flights.state.tick.tolist() == [0, 20, 0]
    assert after.flights.state.push[0] != state.flights.state.push[0]
    assert after.flights.state.push[1] == state.flights.state.push[1]
