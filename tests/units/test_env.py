"""The environments: Gymnasium's checks, the controller's own flight, and that both environments set one task."""

import copy
import pickle
import re
import subprocess
import sys
from dataclasses import replace

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from scipy.spatial.transform import Rotation

from jax_aero import env_gym, rust
from jax_aero.base.features import Aim
from jax_aero.base.places import CONFIGS
from jax_aero.env import FlightEnv
from jax_aero.env_gym import HoverEnv, HoverVectorEnv
from jax_aero.env_task import FEATURES, Task, TaskState, disturb, limit_action, observe, rewards, steer
from jax_aero.rust import load_config
from jax_aero.sim.wind import wind_velocity
from jax_aero.types import replace_values
from tests.measurements import measured

EXPERIMENTS = CONFIGS / "experiments"

WIND = [3.0, -9.0, 0.0]


def aim_of(hover):
    """Return what is followed in the next tick."""
    return Aim(*(part[0] for part in env_gym._observe([hover])[0].aim))


def test_gymnasium_finds_no_fault():
    check_env(HoverEnv(Task(duration=0.2)), skip_render_check=True)


@pytest.mark.slow
def test_an_environment_multiplies_at_full_precision():
    """A GPU would round the factors to ten bits; there a flight and its observation would differ from a processor's."""
    env = FlightEnv(Task(duration=0.1))

    def products(program):
        for equation in program.eqns:
            if equation.primitive.name == "dot_general":
                yield equation.params["precision"]
            for inner in jax.tree.leaves(equation.params, is_leaf=lambda x: hasattr(x, "eqns") or hasattr(x, "jaxpr")):
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from products(inner)

    state = jax.eval_shape(env.reset, jax.random.key(0))
    found = list(products(jax.make_jaxpr(env.step)(state, jnp.zeros(env.action_size)).jaxpr))
    found += products(jax.make_jaxpr(env.reset)(jax.random.key(0)).jaxpr)
    assert len(found) > 50
    assert set(found) == {(jax.lax.Precision.HIGHEST, jax.lax.Precision.HIGHEST)}


def test_pictures_show_the_robot_where_it_is():
    hover = HoverEnv(Task(duration=1.0), render_mode="rgb_array")
    hover.reset(options={"wind": [0.0, 0.0, 0.0]})
    first = hover.render()
    assert (first.shape, len(np.unique(first.reshape(-1, 3), axis=0)) > 100) == ((480, 640, 3), True)
    _ = [hover.step(np.ones(27, np.float32)) for _ in range(20)]
    assert (hover.render() != first).any()
    assert HoverEnv().render() is None


def test_the_environment_of_gymnasium_needs_no_jax():
    """Nor anything else that the extra `rl` does not install."""
    program = (
        "import sys; sys.modules |= dict.fromkeys(['jax', 'jaxtyping', 'matplotlib', 'mujoco', 'pandas', 'xarray']); "
        "from jax_aero.env_gym import HoverEnv; HoverEnv().reset()"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_without_a_residual_the_controller_flies_as_it_does():
    hover = HoverEnv(Task(duration=0.5))
    first, _ = hover.reset(options={"wind": WIND})
    assert first.shape == hover.observation_space.shape
    for tick in range(50):
        _, reward, terminated, truncated, _ = hover.step(np.zeros(27, np.float32))
        assert 0.9 < reward <= 1.0
        assert not terminated
        assert truncated == (tick == 49)
    flown = rust.fly(hover._config)["base_position"][50]
    measured("base after 50 ticks [m]", np.abs(hover._flight.truth.state.base_position - flown).max(), 1e-12)


@pytest.mark.slow
def test_both_environments_are_one_task(x64, tmp_path):
    """Six ticks with drawn actions: observations and rewards, in the environment of JAX and in that of the crate.

    The controller has an estimator, whose model goes on with what acts in both, and is given estimated thrusts. The
    mission rises and turns from the first tick on.
    """
    (tmp_path / "own.toml").write_text(
        f'base = "{EXPERIMENTS}/sensor_noise.toml"\ncontroller.estimator.joint_velocity.time_constant = 0.1\n'
        "mission = { up = [[0.0, 1.0]], yaw_left = [[0.0, 1.0]] }\n"
    )
    task = Task(str(tmp_path / "own.toml"), tracking=True, duration=1.0, ramp=0.05)
    crate, ours = HoverEnv(task), FlightEnv(task)
    assert (ours.action_size, ours.observation_size) == (27, 71)
    task_state, _ = crate.reset(options={"wind": WIND})
    reset = jax.jit(jax.vmap(ours.reset))(jax.random.split(jax.random.key(0), 2))
    speeds = np.linalg.norm(reset.info["wind"], axis=1)
    assert np.all(speeds <= task.wind_max)
    assert speeds[0] != speeds[1]
    states = jax.jit(jax.vmap(ours.start))(jnp.array([WIND, [0.0, 0.0, 0.0]]))
    step = jax.jit(jax.vmap(ours.step))
    measured("first observation", np.abs(states.obs[0] - task_state).max(), 1e-6)
    rng = np.random.default_rng(0)
    for _ in range(6):
        action = rng.uniform(-1.0, 1.0, 27).astype(np.float32)
        task_state, reward, terminated, _, parts = crate.step(action)
        states = step(states, jnp.stack([jnp.asarray(action), jnp.zeros(27, jnp.float32)]))
        measured("observation", np.abs(states.obs[0] - task_state).max(), 1e-6)
        measured("reward", abs(float(states.reward[0]) - reward), 1e-9)
        turned = crate._flight.truth.state.base_rotation.T @ aim_of(crate).rotation
        angle = np.arccos(np.clip(0.5 * (np.trace(turned) - 1.0), -1.0, 1.0))
        # An arc cosine next to 1 has the square root of the rounding of its argument.
        measured("attitude error", abs(float(states.metrics["attitude_error"][0]) - angle), 1e-7)
        assert float(states.done[0]) == terminated == 0.0
    aim = aim_of(crate)
    assert aim.velocity[2] > 1e-6
    assert np.abs(aim.angular_velocity).max() > 1e-6
    assert set(parts) < set(states.metrics)
    assert states.metrics["position_error"].shape == (2,)

    def flown(flight):
        return states.replace(data=states.data._replace(flight=flight))

    lost = flown(states.data.flight._replace(loss=jnp.array([1, 0], jnp.int32)))
    after = step(lost, jnp.zeros((2, 27), jnp.float32))
    assert after.done.tolist() == [1.0, 0.0]
    assert float(after.reward[0]) == 0.0
    # An action that is no number is not flown, but the episode ends, and what is said of it stays finite.
    after = step(states, jnp.full((2, 27), jnp.nan, jnp.float32).at[1].set(0.0))
    assert after.done.tolist() == [1.0, 0.0]
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after.obs, after.reward, after.metrics)))
    assert crate.step(np.full(27, np.nan, np.float32))[1:3] == (0.0, True)
    # Down 0.99 m from the set-point and 1.01 m after the step: lost in this one, as in the environment of the crate.
    plant = states.data.flight.plant
    falling = plant.robot._replace(
        base_position=plant.robot.base_position - jnp.array([[0.0, 0.0, 0.99], [0.0, 0.0, 0.0]]),
        velocity=plant.robot.velocity.at[0, 2].set(-2.0),
    )
    after = step(
        flown(states.data.flight._replace(plant=plant._replace(robot=falling))), jnp.zeros((2, 27), jnp.float32)
    )
    assert after.data.flight.loss.tolist() == [0, 0]
    assert after.done.tolist() == [1.0, 0.0]
    assert float(after.reward[0]) == 0.0


@pytest.mark.slow
def test_the_robot_that_we_recommend_is_one_task_in_both_environments(x64, tmp_path):
    """Drives, sub-steps, late commands, sensors and engines in the law: four ticks with drawn actions, in two winds.

    Its channels (`jump`) hold the wind of a step of 1.9 m/s in a tick, which JAX uses.
    """
    (tmp_path / "own.toml").write_text(f'base = "{EXPERIMENTS}/robot.toml"\nsimulator.aero.precision = "f64"\n')
    task = Task(str(tmp_path / "own.toml"), duration=1.0, ramp=0.5)
    crate, ours = HoverEnv(task), FlightEnv(task)
    crate.reset(options={"wind": WIND})
    states = jax.vmap(ours.start)(jnp.array([WIND, [0.0, 0.0, 0.0]]))
    step, rng = jax.jit(jax.vmap(ours.step)), np.random.default_rng(0)
    for _ in range(4):
        action = rng.uniform(-1.0, 1.0, 27).astype(np.float32)
        seen, reward, terminated, _, _ = crate.step(action)
        states = step(states, jnp.stack([jnp.asarray(action), jnp.zeros(27, jnp.float32)]))
        flown = states.data.flight.plant.robot.velocity[0] - crate._flight.truth.state.velocity
        measured("velocity [m/s, rad/s]", np.abs(flown).max(), 1e-9)
        measured("observation", np.abs(states.obs[0] - seen).max(), 1e-6)
        measured("reward", abs(float(states.reward[0]) - reward), 1e-9)
        assert not terminated
        assert not crate._flight.last.degraded_modes
    assert states.done.tolist() == [0.0, 0.0]
    assert np.abs(states.obs[0] - states.obs[1]).max() > 1e-3
    sudden = HoverEnv(replace(task, ramp=0.05))
    sudden.reset(options={"wind": WIND})
    _ = [sudden.step(np.zeros(27)) for _ in range(2)]
    assert [*sudden._flight.last.degraded_modes] == ["wind_held"]


@pytest.mark.parametrize("tracking", [False, True])
def test_many_episodes_at_once_are_those_of_single_environments(tracking):
    """Three robots of two masses in drawn winds: restarts at the end, after 4 ticks, and after a loss by NaN."""
    task = Task(tracking=tracking, duration=0.04, ramp=0.05)
    drawn = [load_config("test1", {"disturbances.model_error.mass_scale": scale}) for scale in (1.0, 1.2)]
    single = SyncVectorEnv([lambda: HoverEnv(task, drawn)] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    many = HoverVectorEnv(3, task, drawn)
    np.testing.assert_array_equal(single.reset(seed=5)[0], many.reset(seed=5)[0])
    rng, ends = np.random.default_rng(0), []
    for tick in range(10):
        actions = rng.uniform(-1.5, 1.5, (3, 27)).astype(np.float32)
        actions[1, 3] = np.nan if tick == 5 else 0.0
        expected, found = single.step(actions), many.step(actions)
        for ours, theirs in zip(found[:2], expected[:2], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-6)
        np.testing.assert_array_equal(found[2:4], expected[2:4])
        assert set(found[4]) >= {"attitude", "position", "effort"}
        for name in ("_final_obs", "_wind", "wind"):
            np.testing.assert_array_equal(found[4].get(name), expected[4].get(name))
        for number in np.flatnonzero(found[2] | found[3]):
            last = [infos["final_obs"][number] for infos in (found[4], expected[4])]
            np.testing.assert_allclose(*last, rtol=0.0, atol=1e-6)
            final = [
                {name: found["final_info"][name][number] for name in ("attitude", "effort")}
                for found in (found[4], expected[4])
            ]
            assert final[0] == pytest.approx(final[1], abs=1e-6, nan_ok=True)
            assert np.abs(last[0] - found[0][number]).max() > 1e-3
        ends.append((found[2] | found[3]).tolist())
    both, lost = [True] * 3, [False, True, False]
    assert [tick for tick, end in enumerate(ends) if end == lost] == [5, 9]
    assert [tick for tick, end in enumerate(ends) if end == [True, False, True]] == [7]
    assert ends[3] == both


def test_many_episodes_at_once_refuse_what_a_single_one_refuses():
    with pytest.raises(ValueError, match=r"`action` has shape \(27,\); expected \(2, 27\)"):
        HoverVectorEnv(2).step(np.zeros(27, np.float32))
    for environment in (HoverEnv(), HoverVectorEnv(2)):
        with pytest.raises(ValueError, match="options of `reset` are winds; expected `wind`"):
            environment.reset(options={"winds": WIND})
    made = gymnasium.make_vec("jax_aero.env_gym:jax_aero/Hover-v0", 3, "vector_entry_point")
    assert made.reset(seed=1)[0].shape == (3, 71)


@pytest.mark.parametrize("seed", [np.int64(3), np.uint8(3), np.array(3), [3, 4], np.array([3, 4]), (3, np.int32(4))])
def test_a_seed_is_an_integer_of_any_kind(seed):
    """As a generator of NumPy draws it; that of the first environment, or one of each."""
    many, single = HoverVectorEnv(2), [HoverEnv(), HoverEnv()]
    expected = [env.reset(seed=own)[0] for env, own in zip(single, (3, 4), strict=True)]
    np.testing.assert_array_equal(many.reset(seed=seed)[0], expected)


def test_what_is_no_seed_is_refused():
    many = HoverVectorEnv(2)
    for wrong in (1.5, "ab", [1.5, 2], [1]):
        with pytest.raises((TypeError, ValueError)):
            many.reset(seed=wrong)
    first, second = many.reset(seed=[5, None])[0], many.reset(seed=5)[0]
    np.testing.assert_array_equal(first[0], second[0])


def test_libraries_find_the_mode_of_restarts_where_gymnasium_has_it():
    """And wrappers of vector environments that do not ask for another mode go through an episode."""
    many = HoverVectorEnv(2, Task(duration=0.03))
    assert many.autoreset_mode is many.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(gymnasium.wrappers.vector.ClipAction(many))
    wrapped.reset(seed=1)
    infos = [wrapped.step(np.zeros((2, 27), np.float32))[4] for _ in range(3)]
    assert infos[-1]["episode"]["l"].tolist() == [3, 3]
    with pytest.raises(ValueError, match=r"(?i)autoreset"):
        gymnasium.wrappers.vector.NormalizeObservation(many)


def test_flights_that_cannot_go_on_together_are_refused(tmp_path):
    flights = [rust.Flight(load_config(name)) for name in ("test1", "platform_hover")]
    with pytest.raises(ValueError, match="`flights` are of several robots; expected one"):
        rust.observe_flights(flights)
    with pytest.raises(ValueError, match="there are no `flights`"):
        rust.observe_flights([])
    with pytest.raises(ValueError, match=r"`residual.thrust_rate` has shape \[4\]; expected \[1, 4\]"):
        rust.step_flights(flights[:1], rust.Residual(np.zeros(4), np.zeros(23)))
    own = rust.Flight(load_config("test1"), controller=lambda _: rust.Command(np.zeros(4), np.zeros(23)))
    with pytest.raises(ValueError, match="a flight has an `own_controller`"):
        rust.step_flights([own], rust.Residual(np.zeros((1, 4)), np.zeros((1, 23))))


COPIES = {"copied": copy.deepcopy, "pickled": lambda env: pickle.loads(pickle.dumps(env))}


@pytest.mark.parametrize("how", COPIES)
def test_a_copy_in_the_middle_of_an_episode_goes_on_as_the_environment_does(how):
    hover = HoverEnv(Task(duration=0.05))
    hover.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(3):
        hover.step(rng.uniform(-1.0, 1.0, 27).astype(np.float32))
    twin = COPIES[how](hover)
    for _ in range(2):
        action = rng.uniform(-1.5, 1.5, 27).astype(np.float32)
        ours, copied = hover.step(action), twin.step(action)
        assert np.array_equal(ours[0], copied[0])
        assert ours[1:] == copied[1:]
    assert ours[3]  # the end of the episode
    first, _ = hover.reset()  # the same wind is drawn
    assert np.array_equal(first, twin.reset()[0])
    assert hover._config["wind"] == twin._config["wind"]


@pytest.mark.parametrize("how", COPIES)
def test_environments_of_vectors_and_of_jax_are_copied(how):
    many = COPIES[how](SyncVectorEnv([HoverEnv, HoverEnv]))
    assert many.reset(seed=1)[0].shape == (2, 71)
    ours = FlightEnv()
    twin = COPIES[how](ours)
    assert (twin.task, twin.dt, twin.action_size) == (ours.task, ours.dt, ours.action_size)
    assert jax.tree.all(jax.tree.map(np.array_equal, ours.start(jnp.array(WIND)), twin.start(jnp.array(WIND))))


LEARNT = {
    "simulator.sensors": "{ base_position = { noise_std = 0.01 }, seed = 2 }",
    "disturbances.outages": '[{ channel = "base_position", start = 0.1, kind = "missing" }]',
    "disturbances.wind_estimate": "{ delay = 0.1 }",
    "disturbances.controller_wind": '{ profile = "constant", velocity = [0.0, 5.0, 0.0] }',
    "disturbances.jets.failure": '{ jet = "l_arm_jet", time = 0.1, kind = "off" }',
}


@pytest.mark.parametrize("key", LEARNT)
def test_failures_are_learnt_in_gymnasium(key, tmp_path):
    """Without an action the episode is the crate's flight, with sensors, outages and faults; the true state is seen."""
    (tmp_path / "own.toml").write_text(f'base = "{EXPERIMENTS}/test2_observer.toml"\n{key} = {LEARNT[key]}\n')
    hover = HoverEnv(Task(str(tmp_path / "own.toml"), duration=0.3, ramp=0.1))
    hover.reset(options={"wind": WIND})
    flown = rust.fly(hover._config)
    assert len(flown["time"]) > 15  # without an engine it comes down
    for tick in range(1, len(flown["time"])):
        hover.step(np.zeros(27, np.float32))
        assert np.array_equal(hover._flight.truth.state.base_position, flown["base_position"][tick])
    measured = hover._flight.measurement.state.base_position
    is_measured = {
        "simulator.sensors": (measured != flown["base_position"][-1]).all(),
        "disturbances.outages": np.isnan(measured).all(),
    }
    assert is_measured.get(key, True)


def test_an_episode_ends_where_the_flight_is_lost(tmp_path):
    (tmp_path / "own.toml").write_text(f'base = "{EXPERIMENTS}/test1.toml"\nsimulator.fall.com_error = 0.0015\n')
    hover = HoverEnv(Task(str(tmp_path / "own.toml"), ramp=0.05))
    hover.reset(options={"wind": WIND})
    steps = [hover.step(np.zeros(27, np.float32))[1:4] for _ in range(3)]
    assert [terminated for _, terminated, _ in steps] == [False, True, True]
    assert steps[1][0] == 0.0


def test_the_set_point_that_is_observed_is_that_of_the_next_tick(tmp_path):
    (tmp_path / "own.toml").write_text(f'base = "{EXPERIMENTS}/test1.toml"\nmission = {{ up = [[0.0, 1.0]] }}\n')
    hover = HoverEnv(Task(str(tmp_path / "own.toml"), tracking=True, duration=1.0))
    hover.reset(seed=0)
    for _ in range(20):
        aim = aim_of(hover)
        hover.step(np.zeros(27, np.float32))
        assert np.array_equal(aim.com, hover._flight.result()["com_setpoint"][-1])


@pytest.mark.parametrize(
    ("key", "value", "others"),
    [("disturbances.wind_estimate.mean_only", "true", ""), ("controller.torque.steps", "2", "simulator.substeps = 2")],
)
def test_a_task_refuses_the_mean_of_a_later_wind_and_torques_between_ticks(key, value, others, tmp_path):
    (tmp_path / "own.toml").write_text(f'base = "{EXPERIMENTS}/test1.toml"\n{key} = {value}\n{others}\n')
    for environment in (FlightEnv, HoverEnv):
        with pytest.raises(ValueError, match=rf"`{key}` of .*own\.toml is {value}; expected"):
            environment(Task(str(tmp_path / "own.toml")))


def test_the_observation_is_what_its_table_says():
    """In a drawn state, by rotations of SciPy; the thrusts are over the limit of their jet."""
    rng = np.random.default_rng(0)
    base, aimed = Rotation.random(2, rng=rng)
    velocity, joints, posture, com, wrench = (rng.normal(size=size) for size in (8, 2, 2, 3, 6))
    aim = Aim(rng.normal(size=3), aimed.as_matrix(), rng.normal(size=3), rng.normal(size=3))
    limits = np.array([100.0, 60.0, 200.0])
    thrust = np.array([50.0, 60.0, 20.0])
    state = TaskState(base.as_matrix(), velocity, joints, thrust, com, aim, posture, wrench, limits)
    in_base = base.inv().apply
    turned = (aimed.inv() * base).as_rotvec()
    angle = np.linalg.norm(turned)
    parts = [
        in_base([0.0, 0.0, -1.0]),
        np.sin(angle) / angle * turned,
        in_base(com - aim.com),
        in_base(velocity[:3] - aim.velocity),
        in_base(velocity[3:6] - aim.angular_velocity),
        joints - posture,
        0.1 * velocity[6:],
        [0.5, 1.0, 0.1],
        in_base(wrench[:3]) / 36.0,
        in_base(wrench[3:]) / 3.6,
    ]
    np.testing.assert_allclose(observe(np, FEATURES, state), np.concatenate(parts), rtol=1e-12, atol=1e-14)
    chosen = np.concatenate([parts[7], parts[2]])
    np.testing.assert_allclose(observe(np, ("thrust", "position"), state), chosen, rtol=1e-12)
    np.testing.assert_array_equal(observe(np, lambda _, state: state.com, state), com)


def test_an_action_is_thrust_rates_and_joint_velocities():
    action = limit_action(np, [1.0, -3.0, 0.5, 0.25, -0.75], (5,), np.float64)
    rates, velocities = steer(Task(thrust_rate=10.0, joint_velocity=2.0), action, 2)
    assert rates.tolist() == [10.0, -10.0]
    assert velocities.tolist() == [1.0, 0.5, -1.5]


def drawn_in_jax(task, count):
    return jax.vmap(FlightEnv(task).draw_wind)(jax.random.split(jax.random.key(0), count))


def drawn_in_gymnasium(task, count):
    hover = HoverEnv(task)
    return [hover.reset(seed=seed)[1]["wind"] for seed in range(count)]


@pytest.mark.parametrize("draw", [drawn_in_jax, drawn_in_gymnasium])
def test_winds_have_all_directions_and_speeds_alike(draw):
    """Of 200 winds a quarter is in each quadrant and in each quarter of the speeds, within four standard deviations."""
    winds = np.asarray(draw(Task(wind_min=2.0, wind_max=10.0), 200))
    assert not winds[:, 2].any()
    speed, angle = np.linalg.norm(winds, axis=1), np.arctan2(winds[:, 1], winds[:, 0])
    deviation = np.sqrt(200 * 0.25 * 0.75)
    for values, least, most in ((angle, -np.pi, np.pi), (speed, 2.0, 10.0)):
        counts, _ = np.histogram(values, 4, (least, most))
        assert counts.sum() == 200
        assert np.abs(counts - 50).max() < 4.0 * deviation


def test_a_task_names_what_it_does_not_know():
    with pytest.raises(ValueError, match="did you mean test1"):
        FlightEnv(Task(experiment="tset1"))
    with pytest.raises(ValueError, match="`steering` is 'rate'; expected one of residual, rates"):
        Task(steering="rate")
    for wrong in (
        {"wind_max": -3},
        {"wind_max": "a"},
        {"wind_min": -1.0},
        {"ramp": np.nan},
        {"thrust_rate": np.nan},
        {"thrust_rate": -5.0},
        {"joint_velocity": np.inf},
    ):
        ((name, value),) = wrong.items()
        with pytest.raises(ValueError, match=re.escape(f"`{name}` is {value!r}; expected a number ≥ 0")):
            Task(**wrong)
    with pytest.raises(ValueError, match="`profile` is 'storm'; expected one of ramp, gust"):
        Task(profile="storm")
    with pytest.raises(ValueError, match=r"`wind_min` is 13\.0; expected at most `wind_max`, 12.0"):
        Task(wind_min=13.0)
    for duration in (np.nan, 0.0):
        with pytest.raises(ValueError, match=f"`duration` is {duration}; expected a number > 0"):
            Task(duration=duration)
    with pytest.raises(ValueError, match=r"`duration` is 0\.004; expected at least one time step of 0\.01 s"):
        HoverEnv(Task(duration=0.004))


def test_gymnasium_makes_it_by_name():
    task = Task(duration=0.02, wind_min=9.0)
    made = gymnasium.make("jax_aero.env_gym:jax_aero/Hover-v0", task=task)
    _, info = made.reset(seed=1)
    assert 9.0 <= np.hypot(*info["wind"][:2]) <= 12.0
    assert [made.step(np.zeros(27, np.float32))[3] for _ in range(2)] == [False, True]


@pytest.mark.parametrize("tracking", [False, True])
def test_a_hover_is_that_of_the_robot_and_a_mission_that_of_the_controller(tracking, tmp_path):
    """The controller's model has its centre of mass elsewhere."""
    (tmp_path / "own.toml").write_text(
        f'base = "{EXPERIMENTS}/test1.toml"\nmission = {{ up = [[0.0, 1.0]] }}\n'
        "disturbances.model_error.com_offset = [0.02, 0.01, 0.0]\n"
    )
    hover = HoverEnv(Task(str(tmp_path / "own.toml"), tracking=tracking, duration=1.0))
    first, _ = hover.reset(seed=0)
    assert not np.any(first[3:6])
    assert np.any(first[6:9]) == tracking
    start = rust.dynamics(hover._robot, hover._flight.truth.state).com_position
    for _ in range(40):
        hover.step(np.zeros(27, np.float32))
    aim = aim_of(hover)
    if tracking:
        assert np.hypot(*(aim.com - start)[:2]) > 1e-3
        assert aim.com[2] > start[2] + 1e-4
    else:
        np.testing.assert_array_equal(aim.com, start)


def test_a_gust_passes():
    """It is strongest after its rise, and over after as long again."""
    hover = HoverEnv(Task(duration=0.5, profile="gust", ramp=0.1))
    hover.reset(options={"wind": WIND})
    winds = []
    for _ in range(25):
        winds.append(hover._flight.truth.wind)
        hover.step(np.zeros(27, np.float32))
    np.testing.assert_allclose(winds[10], WIND, atol=1e-12)
    assert not np.any(winds[0])
    assert np.abs(winds[21:]).max() < 1e-12
    ours = FlightEnv(hover.task)
    assert ours._drawn.scenario.wind.duration == 0.2


def test_a_wind_that_is_not_finite_is_refused_by_its_key():
    with pytest.raises(ValueError, match=r"`wind\.velocity\.1` is NaN; expected a finite number"):
        HoverEnv().reset(options={"wind": [0.0, np.nan, 0.0]})


@pytest.mark.parametrize("size", [3, 30])
def test_an_action_of_another_shape_is_refused(size):
    hover = FlightEnv()
    for step in (HoverEnv().step, lambda action: hover.step(hover.start(jnp.zeros(3)), action)):
        with pytest.raises(ValueError, match=rf"`action` has shape \({size},\); expected \(27,\)"):
            step(np.zeros(size, np.float32))


def test_the_effort_is_that_of_the_action_that_is_flown():
    """Beyond the bounds none is added; a robot with nothing to steer makes none."""
    nothing, none = np.zeros(3), np.zeros(0)
    aim = Aim(nothing, np.eye(3), nothing, nothing)
    task_state = TaskState(np.eye(3), np.zeros(6), none, none, nothing, aim, none, np.zeros(6), none)
    crate = HoverEnv()
    crate.reset(options={"wind": WIND})
    assert crate.step(np.full(27, 30.0))[4]["effort"] == pytest.approx(-0.01)
    assert sum(rewards(np, task_state, np.zeros(0)).values()) == 1.0


def test_the_reward_falls_with_angle_distance_and_effort():
    """At 1 - cos of 0.05, and at 0.05 m², each half of it is e times less; effort is a hundredth of the mean square."""
    nothing, none, cosine = np.zeros(3), np.zeros(0), 0.95
    sine = np.sqrt(1.0 - cosine**2)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    com, aim = np.array([0.1, 0.2, 0.0]), Aim(nothing, np.eye(3), nothing, nothing)
    task_state = TaskState(turned, np.zeros(6), none, none, com, aim, none, np.zeros(6), none)
    found = rewards(np, task_state, np.array([1.0, -0.5]))
    assert found == pytest.approx({"attitude": 0.5 / np.e, "position": 0.5 / np.e, "effort": -0.00625}, rel=1e-12)


# --- own observation, reward and disturbances


def both(task, **given):
    """Return a tick of both environments in the same wind, without an action: observation, reward and its parts."""
    crate, twin = HoverEnv(task, **given), FlightEnv(task, **given)
    crate.reset(options={"wind": WIND})
    seen, reward, _, _, parts = crate.step(np.zeros(27, np.float32))
    state = jax.jit(twin.step)(twin.start(jnp.array(WIND)), jnp.zeros(27))
    return (seen, reward, parts), (state.obs, state.reward, state.metrics), (crate, twin)


def test_observation_and_reward_are_arguments(x64):
    """A function of one's own, by NumPy over the crate and by JAX; parts are recorded by name."""
    height = lambda xp, state: xp.stack([state.com[..., 2], state.thrust[..., 0]], axis=-1)  # noqa: E731
    reward = lambda xp, state, action: {"low": -state.com[..., 2], "still": 1.0 - xp.sum(action**2, axis=-1)}  # noqa: E731
    ours, twin, (crate, env) = both(Task(ramp=0.1), observation=height, reward=reward)
    assert (crate.observation_space.shape, env.observation_size) == ((2,), 2)
    np.testing.assert_allclose(ours[0], twin[0], rtol=1e-6)
    assert ours[1] == pytest.approx(1.0 - ours[0][0], rel=1e-6) == pytest.approx(float(twin[1]), rel=1e-6)
    assert set(ours[2]) == {"low", "still"} == set(twin[2]) - {"attitude_error", "position_error"}


def test_a_feature_that_is_none_is_refused():
    for environment in (FlightEnv, HoverEnv):
        with pytest.raises(ValueError, match=r"`observation` is \('height',\); expected a function, or names of"):
            environment(observation=("height",))


def test_a_set_point_apart_from_the_start(x64):
    """A robot that begins tilted by 60° and 0.3 m beside it: the errors that both observe are these."""
    task = Task(steering="rates", attitude_deg=(0.0, 0.0, 180.0), offset=(0.3, 0.0, 0.0))
    config = load_config("test1", {"simulator.initial.base_rpy_deg": [60.0, 0.0, 180.0]})
    ours, twin, (_, env) = both(task, drawn=[config])
    np.testing.assert_allclose(ours[0], twin[0], atol=1e-6)
    start = env.start(jnp.zeros(3)).obs
    np.testing.assert_allclose(start[3:6], [np.sin(np.radians(60.0)), 0.0, 0.0], atol=1e-9)
    assert np.linalg.norm(start[6:9]) == pytest.approx(0.3)
    assert float(twin[2]["attitude_error"]) == pytest.approx(np.radians(60.0), abs=0.02)
    for given in ({"tracking": True}, {"steering": "residual"}):
        with pytest.raises(ValueError, match="expected neither with `tracking` or a residual"):
            Task(**{"steering": "rates"} | given, offset=(0.1, 0.0, 0.0))


def test_the_attitude_of_a_set_point_is_that_of_the_fixed_axes():
    aim = Task(steering="rates", attitude_deg=(20.0, -30.0, 50.0)).aim(np, np.zeros(3), np.eye(3))
    expected = Rotation.from_euler("xyz", [20.0, -30.0, 50.0], degrees=True).as_matrix()
    np.testing.assert_allclose(aim.rotation, expected, atol=1e-15)


def test_a_turbulent_wind_is_drawn_anew(x64):
    """Over its speed it has the standard deviation of the task; every episode has other turbulence."""
    task = Task(profile="turbulent", ramp=0.0, turbulence=0.2, duration=30.0)
    env = FlightEnv(task)
    states = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 3))
    assert len(np.unique(states.data.phases[:, 0, 0])) == 3
    scenario = env._pick(0).scenario

    def wind(state, time):
        blown = replace_values(scenario, env._wind(state.data._replace(wind=jnp.array([10.0, 0.0, 0.0]))))
        return wind_velocity(blown.wind, time)

    times = jnp.linspace(0.0, 2000.0, 4001)
    found = jax.vmap(lambda time: wind(jax.tree.map(lambda leaf: leaf[0], states), time))(times)
    np.testing.assert_allclose(found.mean(axis=0), [10.0, 0.0, 0.0], atol=0.3)
    np.testing.assert_allclose(found.std(axis=0), [2.0, 2.0, 1.0], rtol=0.1)
    hover = HoverEnv(task)
    seeds = {hover.reset(seed=seed) and hover._config["wind"]["seed"] for seed in range(3)}
    assert len(seeds) == 3
    assert hover._config["wind"]["std"] == pytest.approx(np.linalg.norm(hover._wind) * np.array([0.2, 0.2, 0.1]))


@pytest.mark.slow
def test_a_curriculum_changes_winds_and_numbers(x64):
    env = FlightEnv(Task(steering="rates"))
    winds = lambda most: jax.vmap(env.at(wind_max=most).draw_wind)(jax.random.split(jax.random.key(0), 50))  # noqa: E731
    assert np.linalg.norm(jax.jit(winds)(2.0), axis=1).max() < 2.0
    heavier = env.at(values={"plant.robot.gravity": 2.0 * env._pick(0).scenario.plant.robot.gravity})
    begun = env.start(jnp.zeros(3))
    fallen = [jax.jit(one.step)(begun, jnp.zeros(27)).data.flight.plant.robot.velocity[2] for one in (env, heavier)]
    assert fallen[1] < fallen[0] - 0.05  # half of 9.81 m/s² more for 0.01 s


def test_drawn_disturbances_fly_in_both(x64):
    """Pushes, kicks and engines that fade differ in numbers alone; a fade is of a drawn jet."""
    config = load_config("test1")
    drawn = disturb(config, 6, 1, push=50.0, kick=20.0, fade=0.5)
    pushes = [one["disturbances"]["pushes"] for one in drawn]
    assert max(np.linalg.norm(push[0]["force"]) for push in pushes) <= 50.0
    assert all(2.0 <= push["start"] <= 8.0 for both in pushes for push in both)
    assert len({one["disturbances"]["jets"]["failure"]["jet"] for one in drawn}) > 1
    assert FlightEnv(Task(), drawn)._count == 6
    HoverEnv(Task(), drawn).reset(seed=0)
    assert disturb(config, 1, 1)[0]["disturbances"] == config["disturbances"]


@pytest.mark.slow
def test_a_mission_is_tracked_with_engines_that_lag(x64):
    config = load_config("test1", {"simulator.jets": {"dynamics": "throttled"}})
    ours, twin, _ = both(Task(tracking=True), drawn=[config])
    np.testing.assert_allclose(ours[0], twin[0], atol=1e-6)


# --- training


class AutoReset:
    """What MuJoCo Playground's wrappers do with an environment and its states, for where it is not installed."""

    def __init__(self, env, episode_length):
        self.env, self.episode_length = env.unwrapped, episode_length

    def reset(self, keys):
        state = jax.vmap(self.env.reset)(keys)
        state.info.update(first_state=state.data, first_obs=state.obs, steps=jnp.zeros_like(state.reward))
        state.metrics["reward"] = state.reward
        return state

    def step(self, state, action):
        steps = jnp.where(state.done, 0.0, state.info["steps"])
        state, _ = jax.lax.scan(
            lambda state, _: (jax.vmap(self.env.step)(state, action), None),
            state.replace(done=jnp.zeros_like(state.done)),
            length=1,
        )
        done = jnp.where(steps + 1.0 >= self.episode_length, 1.0, state.done)
        state.info["steps"] = steps + 1.0

        def restart(first, now):
            return jnp.where(done.reshape([-1] + [1] * (now.ndim - 1)), first, now)

        first = (state.info["first_state"], state.info["first_obs"])
        data, obs = jax.tree.map(restart, first, (state.data, state.obs))
        return state.replace(data=data, obs=obs, done=done)


def playground():
    wrapper = pytest.importorskip(
        "mujoco_playground._src.wrapper", reason="Playground is not installed: pip install brax playground"
    )
    return lambda env, length: wrapper.wrap_for_brax_training(env, episode_length=length, action_repeat=1)


@pytest.mark.slow
@pytest.mark.parametrize("wrap", [AutoReset, playground])
def test_wrappers_restart_it(wrap):
    """Two episodes of three ticks, of robots whose controllers have other masses: a restart is the first state."""
    wrap = wrap() if wrap is playground else wrap
    scales = (0.9, 1.05, 1.1)
    drawn = [load_config("test1", {"disturbances.model_error.mass_scale": scale}) for scale in scales]
    wrapped = wrap(FlightEnv(Task(duration=1.0), drawn=drawn), 3)
    keys = jnp.stack([jax.random.PRNGKey(seed) for seed in range(6)])
    states = first = jax.jit(wrapped.reset)(keys)
    assert first.info["wind"].shape == (6, 3)
    assert len(set(first.data.drawn.tolist())) > 1
    step = jax.jit(wrapped.step)
    flown = []
    for _ in range(6):
        states = step(states, jnp.zeros((6, 27)))
        flown.append(states)
    assert [one.done.tolist() for one in flown] == [[0.0] * 6, [0.0] * 6, [1.0] * 6] * 2
    assert jax.tree.all(jax.tree.map(np.array_equal, flown[2].data, first.data))
    assert np.array_equal(flown[3].obs, flown[0].obs)
    assert float(flown[1].reward.min()) > 0.9  # no action is the hover of every robot that is drawn


def test_an_episode_draws_a_robot_in_both_environments():
    drawn = [load_config("test1", {"disturbances.model_error.mass_scale": scale}) for scale in (1.0, 1.2)]
    hover = HoverEnv(drawn=drawn)
    scales = set()
    for seed in range(8):
        _, info = hover.reset(seed=seed)
        assert isinstance(info["wind"], np.ndarray)
        scales.add(hover._config["disturbances"]["model_error"]["mass_scale"])
    assert scales == {1.0, 1.2}
    starts = [load_config("test1", {"simulator.initial.thrust": [thrust] * 4}) for thrust in (90.0, 100.0)]
    begun = jax.jit(jax.vmap(FlightEnv(drawn=starts).start))(jnp.zeros((2, 3)), jnp.array([1, 0]))
    assert begun.data.flight.plant.jets.thrust[:, 0].tolist() == [100.0, 90.0]
    with pytest.raises(ValueError, match=r"`drawn\[1\]` differs from `drawn\[0\]` in more than numbers"):
        FlightEnv(drawn=[drawn[0], load_config("mk3_hover")])


@pytest.mark.parametrize("environment", [FlightEnv, HoverEnv])
def test_a_task_may_be_the_name_of_an_experiment(environment):
    assert environment("test2").task == Task(experiment="test2")
    with pytest.raises(ValueError, match="`task` is 3; expected a Task, or the name of an experiment"):
        environment(3)
