"""Training of policies, on a mass in place of a robot: what is learnt, clipped, begun anew and resumed."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from msgspec import structs
from scipy.spatial.transform import Rotation

from jax_aero.base.features import Aim
from jax_aero.control.law.residual import evaluate
from jax_aero.env_task import FEATURES, TaskState, rewards
from jax_aero.train import policy
from jax_aero.train.policy import Settings, init_network, perceptron, trainer

SETTINGS = Settings(steps=60, batch=8, ticks=20, learning_rate=0.03, hidden=(4, 4))


class Mass(NamedTuple):
    position: Any
    push: Any
    tick: Any
    obs: Any
    reward: Any
    done: Any


class Spring:
    """A damped mass on a spring, pushed by a constant force; lost beyond 1.5 m. It has one jet and one joint."""

    observation, observation_size, jets, action_size, dt, episode_length = FEATURES, 24, 1, 2, 0.05, 60

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


class Tilted(Spring):
    """The same, whose observation at rest is not zero, and which is pushed by as much as a curriculum says."""

    most = 1.0

    def reset(self, key):
        return self.start(self.most * jax.random.uniform(key, (3,), minval=-1.0, maxval=1.0), 0)

    def start(self, wind, number):
        state = super().start(wind, number)
        return state._replace(obs=state.obs.at[2].set(-1.0))

    def step(self, state, action):
        after = super().step(state, action)
        return after._replace(obs=after.obs.at[2].set(-1.0))

    def at(self, most):
        other = Tilted()
        other.most = most
        return other


def train(settings, seed, folder, env=None, **given):
    """Train; `network` and `curriculum` are those of a trainer, all others of its training."""
    of = {name: given.pop(name) for name in ("network", "curriculum") if name in given}
    return trainer(env or Spring(), settings, **of).train(seed, checkpoint=folder / "c", digest="a", **given)


def judge(found, env=None, network=None):
    winds, numbers = jnp.array([[-0.9, 0.0, 0.0], [0.9, 0.0, 0.0]]), jnp.zeros(2, jnp.int32)
    env = env or Spring()
    return policy.fly_episodes(env, network or perceptron(env, SETTINGS.hidden), found, winds, numbers)


def test_every_number_of_an_observation_has_the_factor_of_its_feature():
    """Of two joints and three jets, and of features in another order."""
    scale = policy.scale_of(FEATURES, 3, 5)
    assert scale[:15].tolist() == np.repeat([9.0, 15.0, 6.0, 3.0, 3.0], 3).tolist()
    assert scale[15:].tolist() == [3.0] * 13
    assert policy.scale_of(("thrust", "position"), 3, 5).tolist() == [3.0] * 3 + [6.0] * 3


@pytest.mark.parametrize("hidden", [(), (4, 3)])
def test_a_card_has_the_actions_of_the_network_and_gives_its_parameters_back(hidden):
    """What is observed at the set-point is subtracted in training, and in a card a part of the biases."""
    network = perceptron(Tilted(), hidden)
    assert network.centre[2] == -1.0
    rng = np.random.default_rng(0)
    drawn = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape).astype(np.float32), network.init(jax.random.key(1)))
    obs = rng.normal(size=24).astype(np.float32)
    card = network.to_policy(drawn)
    np.testing.assert_allclose(evaluate(np, card, network.scale * obs), network.apply(drawn, obs), atol=1e-5)
    back = network.from_policy(card)
    assert jax.tree.all(jax.tree.map(lambda a, b: np.allclose(a, b, atol=1e-5), back, drawn))


def test_training_holds_a_mass_against_a_force(tmp_path):
    """By whole episodes in forces of its own."""
    found = train(SETTINGS, 0, tmp_path)
    assert len(found.rows) == 60
    rewards, survived = judge(found.parameters)
    without, _ = judge(jax.tree.map(jnp.zeros_like, found.parameters))
    assert (rewards > without + 0.3).all()
    assert survived.tolist() == [1.0, 1.0]
    assert np.any(found.parameters.direct)


class Gain:
    """A network of one's own: a gain on what is observed of the force, and one on the position."""

    def init(self, key):
        return {"gain": jnp.zeros(2), "noise": 0.01 * jax.random.normal(key, (2,))}

    def apply(self, parameters, obs):
        return jnp.tanh(parameters["gain"] @ jnp.array([obs[6], obs[18]]) + parameters["noise"])


def test_parameters_of_any_structure_are_trained_checkpointed_and_resumed(tmp_path):
    network = Gain()
    settings = Settings(steps=40, batch=8, ticks=20, learning_rate=0.1)
    found = train(settings, 0, tmp_path, network=network)
    rewards, _ = judge(found.parameters, network=network)
    assert found.parameters["gain"][1] < -0.1  # against the force
    assert (rewards > judge(network.init(jax.random.key(0)), network=network)[0] + 0.1).all()
    again = train(settings, 0, tmp_path, network=network, on_step=lambda *_: pytest.fail("it is finished"))
    assert again.parameters["gain"].tolist() == found.parameters["gain"].tolist()


def test_a_training_begins_with_given_parameters(tmp_path):
    """A warm start with the parameters of a finished training, and a rate of almost nothing, stays there."""
    found = train(SETTINGS, 0, tmp_path)
    few = Settings(steps=1, batch=2, ticks=5, learning_rate=1e-9, least_rate=0.0, hidden=(4, 4))
    warm = train(few, 1, tmp_path / "warm", start=found.parameters)
    assert jax.tree.all(jax.tree.map(lambda a, b: np.allclose(a, b, atol=1e-6), warm.parameters, found.parameters))


def test_a_curriculum_makes_the_environment_of_every_step(tmp_path):
    """Without a force up to the third step, a mass at rest earns everything; flights that begin later are pushed."""
    settings = Settings(steps=6, batch=4, ticks=60, learning_rate=1e-9, least_rate=0.0, hidden=(2,))
    curriculum = lambda env, step: env.at(jnp.where(step < 3, 0.0, 1.0))  # noqa: E731
    rows = train(settings, 0, tmp_path, Tilted(), curriculum=curriculum).rows
    assert all(row.reward > 0.99 for row in rows[:4])  # its flights begin at the end of the step before
    assert all(row.reward < 0.9 for row in rows[4:])


def test_an_episode_counts_until_it_is_lost():
    """An action of 1 takes the mass beyond 1.5 m for good; of 60 ticks it earns what it had before."""
    pushing = init_network(jax.random.key(1), 24, (2,), 2, 0.0)
    pushing = policy.Policy(pushing.hidden, pushing.output._replace(bias=jnp.array([9.0, 0.0])), pushing.direct)
    of = Spring(), perceptron(Spring(), (2,)), pushing
    (reward,), (survived,) = policy.fly_episodes(*of, jnp.array([[0.9, 0.0, 0.0]]), jnp.zeros(1, int))
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
    assert jax.tree.all(jax.tree.map(np.array_equal, again.parameters, whole.parameters))


@pytest.mark.slow
def test_a_checkpoint_of_another_training_does_not_count(tmp_path):
    """Of another seed, setting, network or digest; one with fewer steps does, and goes on."""
    few = Settings(steps=2, batch=2, ticks=5, hidden=(2,))
    done = []
    for seed, changes in ((0, {}), (1, {}), (1, {"learning_rate": 0.1}), (1, {"hidden": (3,)}), (1, {"hidden": (3,)})):
        train(structs.replace(few, **changes), seed, tmp_path, on_step=lambda step, *_: done.append(step))
    assert done == 4 * [1, 2], "the last one is finished"
    train(structs.replace(few, hidden=(3,), steps=3), 1, tmp_path, on_step=lambda step, *_: done.append(step))
    assert done[8:] == [3]
    named = trainer(Spring(), few)
    for digest in ("one reward", "another reward"):
        named.train(0, checkpoint=tmp_path / "d", digest=digest, on_step=lambda step, *_: done.append(step))
    assert done[9:] == 2 * [1, 2]


def test_gradients_are_clipped_flight_by_flight():
    """The second is long, the third is not finite, the fourth is chaotic."""
    gradients = {"a": jnp.array([[0.3], [3.0], [jnp.nan], [1e5]]), "b": jnp.array([[[0.4]], [[4.0]], [[1.0]], [[1.0]]])}
    clipped = policy.clip_each(gradients, 1.0)
    np.testing.assert_allclose(clipped["a"].ravel(), [0.3, 0.6, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(clipped["b"].ravel(), [0.4, 0.8, 0.0, 0.0], rtol=1e-6)


def test_a_window_counts_rewards_until_the_loss():
    network = perceptron(Spring(), (2,))
    still = jax.tree.map(jnp.zeros_like, network.init(jax.random.key(1)))
    flight = policy.Flight(Spring().start(jnp.zeros(3), 0), jnp.zeros((), jnp.int32))
    cost, (after, _, _) = policy.fly_window(Spring(), network, 2, still, flight)
    assert float(cost) == pytest.approx(-1.0, rel=1e-6)
    assert (int(after.age), int(after.state.tick)) == (2, 2)
    lost = policy.Flight(flight.state._replace(position=jnp.array(9.0)), flight.age)
    assert float(policy.fly_window(Spring(), network, 2, still, lost)[0]) == 0.0


def state_of(rotation, com, velocity):
    nothing = np.zeros(3)
    aim = Aim(nothing, np.eye(3), nothing, nothing)
    return TaskState(rotation, np.array(velocity), nothing, nothing, np.array(com), aim, nothing, nothing, nothing)


@pytest.mark.parametrize("turn", [np.eye(3), Rotation.from_euler("z", 90, degrees=True).as_matrix()])
def test_the_reward_of_training_is_that_of_the_task_less_one_near_the_set_point(turn):
    """Errors of 0.01 rad and m differ by their fourth powers; without looking ahead, velocities do not count."""
    state = state_of(turn @ Rotation.from_rotvec([0.01, 0.0, 0.0]).as_matrix(), [0.0, 0.01, 0.0], [0.1] * 6)
    state = state._replace(aim=state.aim._replace(rotation=turn))
    ours, task = (sum(of(np, state, np.zeros(2)).values()) for of in (policy.approach(0.0), rewards))
    assert ours == pytest.approx(task - 1.0, abs=1e-5)
    assert abs(ours) > 1e-3


def test_an_approach_with_the_time_constant_is_a_perfect_flight():
    """e + τ v = 0 and φ + τ ω = 0, in inertial axes of a base that is turned; its opposite is a worse one."""
    turned = Rotation.from_rotvec([0.0, 0.0, 0.02])
    for sign, best in ((-1.0, True), (1.0, False)):
        velocity = sign * np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.04])
        parts = policy.approach(0.5)(np, state_of(turned.as_matrix(), [0.1, 0.0, 0.0], velocity), np.zeros(2))
        assert (parts["position"] > -1e-12) == (parts["attitude"] > -1e-6) == best


def test_the_reward_of_training_has_a_gradient_where_that_of_the_task_has_none():
    """A metre away."""
    at = lambda reward, x: reward(jnp, state_of(jnp.eye(3), [x, 0.0, 0.0], [0.0] * 6), jnp.zeros(2))["position"]  # noqa: E731
    slope = lambda reward: abs(at(reward, 1.01) - at(reward, 0.99)) / 0.02  # noqa: E731
    assert slope(rewards) < 1e-6
    assert slope(policy.approach(0.0)) > 0.5


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
