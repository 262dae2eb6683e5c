"""Learned policies: crate, JAX and the environment in which they are trained agree, and read the same cards."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.studies.policy.study import rewards_in_crate
from jax_aero import rust
from jax_aero.base.cards import copy_card
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import rotation_from_wxyz
from jax_aero.control import Measurement
from jax_aero.control.law.policy_card import load_policy, save_policy
from jax_aero.env import FlightEnv
from jax_aero.env_task import FEATURES, Task
from jax_aero.rust import MODES
from jax_aero.sim import prepare, step
from jax_aero.train.policy import init_network, perceptron, residual_of, warm_start
from jax_aero.types import State

CARD = Path(__file__).resolve().parents[2] / "configs/policies/hover.json"
TASK = Task("test1", "rates", duration=1.0, ramp=0.1, thrust_rate=200.0, joint_velocity=2.0)
WIND = [3.0, -9.0, 0.0]


@pytest.fixture(scope="module")
def robot():
    return load_robot(rust.load_config("test1")["robot"])


@pytest.fixture(scope="module")
def drawn(robot, tmp_path_factory):
    """Card of a policy that replaces the law: drawn weights of two hidden layers and a linear part, all features."""
    policy = init_network(jax.random.key(2), 71, (5, 3), 27, 0.3)
    policy = replace(policy, direct=0.03 * jax.random.normal(jax.random.key(3), policy.direct.shape))
    path = tmp_path_factory.mktemp("card") / "drawn.json"
    save_policy(path, residual_of(policy, TASK, robot.jets.count), robot, description="Drawn.", training={})
    return path


@pytest.mark.parametrize("replaces", [False, True])
def test_both_act_alike(replaces, x64, measured, robot, drawn):
    """Two ticks in drawn states: the second one has an observed wrench."""
    card = {"controller.policy": {"card": drawn if replaces else CARD}}
    config = rust.load_config("test1", {"controller.channels.jump": False, **card})
    scenario, _ = prepare(config)
    controller, crate = scenario.controller, rust.Controller(config)
    tick = jax.jit(controller.step)
    rng = np.random.default_rng(0)
    posture = np.asarray(config["simulator"]["initial"]["joint_position"])

    def draw(size):
        turned = np.array([1.0, *(0.2 * size * rng.normal(size=3))])
        return State(
            base_position=size * rng.normal(size=3),
            base_rotation=np.asarray(rotation_from_wxyz(turned / np.linalg.norm(turned))),
            joint_position=posture + 0.02 * rng.normal(size=23),
            velocity=0.1 * size * rng.normal(size=29),
        )

    thrust, still = np.full(4, 100.0), np.zeros(3)
    for _ in range(5):
        crate, first = rust.Controller(config), draw(0.0)
        memory = controller.init(robot, first)
        for number, state in enumerate((first, draw(0.2), draw(0.2))):
            time = 0.01 * number
            memory, command = tick(robot, memory, Measurement(jnp.asarray(time), state, thrust, still))
            theirs = crate.tick(state, thrust, still, time)
            ours = np.concatenate(command.terms.residual)
            measured("observed wrench [N, N m]", np.abs(memory.residual.wrench - theirs.residual_wrench).max(), 1e-7)
            # In an action of 100 N/s a rounding of the wrench, of some 1e-10 of thousands of N, is multiplied by a few.
            measured("residual [N/s, rad/s]", np.abs(ours - theirs.residual).max(), 1e-7)
            measured("thrust rates [N/s]", np.abs(command.thrust_rate - theirs.thrust_rate).max(), 1e-6)
        assert np.abs(ours).max() > 1.0


def test_a_policy_flies_in_the_crate_as_in_the_environment(x64, measured, robot, drawn):
    """In the environment it is a function of the observation, in crate and twin the law of the controller."""
    env, ticks = FlightEnv(TASK), 40
    network = perceptron(env, (5, 3))
    trained = warm_start(load_policy(drawn, robot), network)

    def fly_on(state, _):
        after = env.step(state, network.apply(trained, state.obs))
        return after, (state.data.flight.plant.robot.base_position, after.reward)

    _, (ours, earned) = jax.jit(lambda state: jax.lax.scan(fly_on, state, length=ticks))(env.start(jnp.array(WIND)))
    config = TASK.episode(rust.load_config(TASK.experiment, {"controller.policy": {"card": drawn}}))
    config = {**config, "wind": {**config["wind"], "velocity": WIND}}
    theirs = rust.fly(config)
    scenario, begun = prepare(config)

    def fly_twin(state):
        return jax.lax.scan(lambda one, tick: step(scenario, one, tick), state, jnp.arange(ticks))[1]

    twin = jax.jit(fly_twin)(begun)
    # The loop multiplies roundings of 1e-12 by a hundred within half a second.
    measured("environment: base [m]", np.abs(ours - theirs["base_position"][:ticks]).max(), 1e-9)
    measured("environment: reward", np.abs(earned - np.array(rewards_in_crate(config, TASK)[:ticks])).max(), 1e-9)
    measured("twin: base [m]", np.abs(twin["base_position"] - theirs["base_position"][:ticks]).max(), 1e-9)
    measured("twin: thrust rates [N/s]", np.abs(twin["thrust_rate"] - theirs["thrust_rate"][:ticks]).max(), 1e-5)


def test_a_card_of_some_features_is_written_and_goes_on(x64, tmp_path, robot):
    """In their order; a card of others, or of other widths, is refused by its key."""
    names = ("thrust", "position", "gravity")
    network = perceptron(FlightEnv(TASK, observation=names), (2,))
    drawn = network.init(jax.random.key(0))
    path = tmp_path / "own.json"
    save_policy(path, residual_of(network.to_policy(drawn), TASK, 4, names), robot, description="Ours.", training={})
    rust.load_config("test1", {"controller.policy": {"card": path}})
    again = warm_start(load_policy(path, robot), network, names)
    assert jax.tree.all(jax.tree.map(lambda a, b: np.allclose(a, b, atol=1e-6), again, drawn))
    for of, given, match in ((network, FEATURES, "features"), (replace(network, hidden=(3,)), names, "hidden")):
        with pytest.raises(ValueError, match=f"`[a-z.]*{match}` of the card is"):
            warm_start(load_policy(path, robot), of, given)
    for policy, seen in (({"gain": 1.0}, names), (drawn, lambda _, state: state.com)):
        with pytest.raises(ValueError, match="what a card holds"):
            residual_of(policy, TASK, 4, seen)


def test_a_residual_that_is_no_number_is_named(x64, robot):
    """As in the crate; without it the command is that of the law."""
    scenario, begun = prepare(rust.load_config("test1_policy"))
    controller, memory = scenario.controller, begun.controller._replace(residual=None)
    spoilt = replace(controller, residual=replace(controller.residual, scale=controller.residual.scale * jnp.nan))

    def first_tick(law, begun):
        return step(replace(scenario, controller=law), begun, 0)[1]

    @jax.jit
    def first_ticks(begun):
        without = replace(controller, residual=None)
        return first_tick(spoilt, begun), first_tick(without, begun._replace(controller=memory))

    with_nan, alone = first_ticks(begun)
    assert int(with_nan["degraded_modes"]) == MODES["residual_ignored"]
    # Two laws in a program, which a compiler orders each in its own way.
    np.testing.assert_allclose(with_nan["thrust_rate"], alone["thrust_rate"], rtol=1e-10)
    np.testing.assert_allclose(with_nan["joint_torque"], alone["joint_torque"], rtol=1e-10, atol=1e-10)


def test_a_card_is_read_as_it_was_written(x64, tmp_path, robot):
    policy = init_network(jax.random.key(1), 71, (4, 3), 27, 1.0)
    written = residual_of(policy, TASK, robot.jets.count)
    card = save_policy(tmp_path / "own.json", written, robot, description="Ours.", training={"seed": 1})
    read = load_policy(tmp_path / "own.json", robot)
    assert card["architecture"] == {"hidden": [4, 3]}
    assert (read.features, read.replaces) == (written.features, True)
    np.testing.assert_array_equal(read.scale, written.scale)
    for ours, theirs in zip(jax.tree.leaves(read.policy), jax.tree.leaves(policy), strict=True):
        np.testing.assert_array_equal(ours, np.asarray(theirs, np.float32))
    copy_card(tmp_path / "own.json", tmp_path / "again.json")
    rust.load_config(TASK.experiment, {"controller.policy": {"card": tmp_path / "again.json"}})


def test_both_refuse_a_card_by_its_key(tmp_path, robot):
    """What is refused: `rust/core/tests/residual.rs`."""
    copy_card(CARD, tmp_path / "own.json")
    card = json.loads((tmp_path / "own.json").read_text())
    card["output"]["replaces"] = 1
    (tmp_path / "own.json").write_text(json.dumps(card))
    with pytest.raises(ValueError, match="replaces"):
        load_policy(tmp_path / "own.json", robot)
    with pytest.raises(ValueError, match="replaces"):
        rust.load_config("test1", {"controller.policy": {"card": tmp_path / "own.json"}})


def test_a_controller_without_jets_is_refused():
    expected = r"controller\.policy\.card is .*; expected none without controller\.use_jets"
    with pytest.raises(ValueError, match=expected):
        rust.load_config("test1_policy", {"controller.use_jets": False})
