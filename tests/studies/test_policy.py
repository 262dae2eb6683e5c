"""The study of learnt hovering: what is judged, drawn and stored; PPO, on a mass in place of a robot."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments.studies.policy import ppo
from experiments.studies.policy import study as policy
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.cards import copy_card
from jax_aero.base.terminal import ConfigError
from jax_aero.env_gym import HoverEnv
from jax_aero.env_task import Task
from jax_aero.figures.catalogue import FIGURES
from jax_aero.train.policy import Perceptron, Row, TrainingResult, fly_episodes, init_network
from tests.train.test_policy import Spring

FILE = """
title = "Short"
duration = 0.05
seeds = [3, 4]
starts = 2
episodes = 64
judge_every = 2
gradients = { steps = 3, hidden = [2] }
"""


class Trainer:
    """In place of a training: three steps of half a minute, with a judgement at the second."""

    steps = 3

    def train(self, seed, *, checkpoint, digest, on_step):
        del digest
        assert checkpoint.suffix == ".part"
        drawn = init_network(jax.random.key(seed), 71, (2,), 27, 1.0)
        rows = [Row(0.5, 0.0, 30.0, 40.0)] * 3
        for step in (1, 2, 3):
            on_step(step, drawn, rows[:step])
        return TrainingResult(drawn, tuple(rows))


def test_policies_are_judged_on_the_way_and_at_the_end(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path / "results")
    network = Perceptron(np.zeros(71, np.float32), np.ones(71, np.float32), (2,), 27)
    monkeypatch.setattr(policy.PolicyConfig, "training", lambda *_: (Trainer(), network))
    monkeypatch.setattr(policy, "judge_of", lambda *_: lambda _, n: (np.linspace(0.9, 1.0, n), np.arange(n) > 0))
    (tmp_path / "short.toml").write_text(FILE)
    document = policy.STUDY.run(str(tmp_path / "short.toml"))
    found = document["summary"]["seed 4"]
    assert found["reward"] == pytest.approx(0.95)
    assert (found["fallen"], found["processor [min]"], found["wall [min]"]) == (1, 1.5, 2.0)
    assert found["processor to a reward of 0.9 [min]"] == 1.0
    copy_card(places.RESULTS / "policy/short/seed_4.json", tmp_path / "own.json")
    rust.load_config("test1", {"controller.policy": {"card": tmp_path / "own.json"}})
    figure, hashes = FIGURES["policy"].draw_from_results(places.RESULTS, ["short"])
    assert isinstance(figure, Figure)
    assert hashes == {"short": document["config_digest"]}


def test_winds_are_those_of_the_task():
    winds = policy.draw_winds(1, 400, Task())
    speeds = np.linalg.norm(winds, axis=1)
    assert speeds.max() < 12.0
    assert np.linalg.norm(policy.draw_winds(1, 400, Task(wind_min=8.0)), axis=1).min() > 8.0
    assert abs(speeds.mean() - 6.0) < 0.5
    assert np.abs(winds.mean(axis=0)).max() < 1.0
    assert not winds[:, 2].any()


def test_starts_of_training_and_judgement_differ():
    config = policy.STUDY.read("hover")[1]
    assert config.task == Task("test1", "rates", thrust_rate=200.0, joint_velocity=2.0)
    seeds = policy.TRAINING, policy.JUDGEMENT
    starts = [one["simulator"]["initial"] for seed in seeds for one in config.drawn(seed, 2)]
    for name, width in (("joint_position", 0.02), ("base_rpy_deg", 1.0), ("base_velocity", 0.05), ("thrust", 2.0)):
        drawn = np.array([start[name] for start in starts])
        assert len(np.unique(drawn[:, 0])) == 4
        assert np.abs(drawn - drawn[0]).max() <= 2.0 * width


def test_a_training_with_a_robot_s_engines_is_pushed_and_kicked_in_turbulence():
    """Every episode otherwise, by at most what the file says; engines answer late."""
    config = policy.STUDY.read("hover_engines")[1]
    assert config.task.profile == "turbulent"
    drawn = config.drawn(policy.TRAINING, 8)
    pushes, kicks = zip(*(one["disturbances"]["pushes"] for one in drawn), strict=True)
    forces, moments = (np.array([one[key] for one in of]) for of, key in ((pushes, "force"), (kicks, "moment")))
    for vectors, most in ((forces, config.disturbed.push), (moments, config.disturbed.kick)):
        sizes = np.linalg.norm(vectors, axis=1)
        assert len(np.unique(sizes)) == 8
        assert 0.0 < sizes.min() < sizes.max() <= most
    assert {one["simulator"]["actuation"]["thrust_delay"] for one in drawn} == {0.04}


def test_a_flight_of_the_crate_earns_what_it_earns_in_the_environment():
    task = Task("test1", duration=0.2, ramp=0.05)
    hover = HoverEnv(task)
    hover.reset(options={"wind": [3.0, -9.0, 0.0]})
    config = hover._config
    earned = [hover.step(np.zeros(27, np.float32))[1] for _ in range(20)]
    assert policy.rewards_in_crate(config, task) == earned


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("seeds = [3, 3]", r"`seeds` is .*; expected each seed once"),
        ("episodes = 65", "`episodes` is 65; expected a multiple of 64"),
        ("ppo = { steps = 3 }", "`ppo` is .given.; expected a table where there is no `gradients`"),
    ],
)
def test_a_configuration_is_refused_by_its_key(change, message, tmp_path):
    key = change.split()[0]
    kept = [line for line in FILE.splitlines() if not line.startswith(f"{key} ")]
    (tmp_path / "short.toml").write_text("\n".join([*kept[:2], change, *kept[2:]]))
    with pytest.raises(ConfigError, match=message):
        policy.STUDY.read(str(tmp_path / "short.toml"))


# --- PPO

SETTINGS = ppo.Settings(steps=60, batch=8, ticks=20, learning_rate=0.01, hidden=(4,), discount=0.9, parts=2)


def learnt_of(deviations):
    """Return a policy and a value of zero."""
    zero_policy, zero_value = (init_network(jax.random.key(1), 24, (2,), outputs, 0.0) for outputs in (2, 1))
    return ppo.Learnt(zero_policy, jnp.log(jnp.array(deviations)), zero_value)


@pytest.mark.slow
def test_ppo_holds_a_mass_against_a_force(tmp_path):
    found = ppo.trainer(Spring(), SETTINGS).train(0, checkpoint=tmp_path / "c", digest="a")
    network = ppo.network_of(Spring(), SETTINGS)
    winds, numbers = jnp.array([[-0.9, 0.0, 0.0], [0.9, 0.0, 0.0]]), jnp.zeros(2, jnp.int32)
    nothing = jax.tree.map(jnp.zeros_like, found.parameters)
    rewards, without = (fly_episodes(Spring(), network, one, winds, numbers)[0] for one in (found.parameters, nothing))
    assert (rewards > without + 0.1).all()


def test_a_network_begins_with_small_actions_of_observations_as_they_are():
    network = ppo.network_of(Spring(), SETTINGS)
    parameters, obs = network.init(jax.random.key(0)), jnp.linspace(-1.0, 1.0, 24)
    np.testing.assert_allclose(parameters.moments.scale(obs), obs, atol=1e-6)
    actions = network.apply(parameters, obs)
    assert actions.shape == (2,)
    assert 0.0 < float(jnp.abs(actions).max()) < 0.05


def test_observations_are_scaled_by_their_running_moments():
    """Of two windows they are those of all their rows; what never changes stays limited."""
    rng = np.random.default_rng(0)
    first, second = rng.normal([1.0, -2.0], [3.0, 0.5], (40, 2)), rng.normal([0.0, 5.0], 1.0, (60, 2))
    nothing = ppo.Moments(jnp.zeros(2), jnp.ones(2), jnp.zeros(()))
    found = nothing.updated(jnp.asarray(first)).updated(jnp.asarray(second))
    rows = np.concatenate([first, second])
    np.testing.assert_allclose(found.mean, rows.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(found.square, rows.var(axis=0), rtol=1e-5)
    scaled = found.scale(jnp.asarray(rows))
    np.testing.assert_allclose([scaled.mean(axis=0), scaled.std(axis=0)], [[0.0] * 2, [1.0] * 2], atol=1e-4)
    assert float(ppo.Moments(jnp.zeros(1), jnp.zeros(1), 1.0).scale(jnp.ones(1))[0]) == ppo.LARGEST


def test_an_advantage_is_the_sum_of_surprises_until_the_loss():
    """Values of zero leave rewards; the second of four ticks is that of the loss."""
    obs, reward = jnp.zeros((4, 24)), jnp.array([1.0, 2.0, 4.0, 8.0])
    seen = ppo.Seen(obs, obs, jnp.zeros((4, 2)), reward, jnp.array([0.0, 1.0, 0.0, 0.0]))
    decay = SETTINGS.discount * SETTINGS.trace
    samples = ppo._judge(SETTINGS, learnt_of([1.0, 1.0]), seen)
    np.testing.assert_allclose(samples.advantage, [1.0 + decay * 2.0, 2.0, 4.0 + decay * 8.0, 8.0], rtol=1e-6)
    assert samples.weight.tolist() == [1.0, 1.0, 0.0, 0.0]


def test_the_gain_of_an_action_ends_at_the_clip():
    """A likelier good action, and a rarer bad one, gain up to the clip; the others lose without bound."""
    learnt = learnt_of([1.0, 1.0])
    here = ppo.log_likelihood(learnt, jnp.zeros(24), jnp.zeros(2))

    def cost(ratio, advantage):
        one = ppo.Sample(jnp.zeros(24), jnp.zeros(2), here - jnp.log(ratio), advantage, 0.0, 1.0)
        return float(ppo._cost(SETTINGS, learnt, jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], one)))

    found = [cost(ratio, advantage) for ratio, advantage in ((3.0, 1.0), (0.3, 1.0), (0.3, -1.0), (3.0, -1.0))]
    np.testing.assert_allclose(found, [-1.2, -0.3, 0.8, 3.0], rtol=1e-5)


def test_a_likelihood_is_that_of_a_normal_distribution():
    learnt = learnt_of([0.5, 2.0])
    found = partial(ppo.log_likelihood, learnt, jnp.zeros(24))
    # One standard deviation in the first, two in the second: ½ (1 + 4).
    assert float(found(jnp.zeros(2)) - found(jnp.array([0.5, -4.0]))) == pytest.approx(2.5)
    assert float(found(jnp.zeros(2))) == pytest.approx(0.0, abs=1e-6)  # log 0.5 + log 2
