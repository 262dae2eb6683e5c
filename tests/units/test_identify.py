"""A robot's numbers from made-up logs, whose motion obeys its equations with other numbers than those of its file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import Axisymmetric
from jax_aero.base import places, plain, tables
from jax_aero.base.places import CONFIGS
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import exp_so3
from jax_aero.commands import fly
from jax_aero.commands import identify as command
from jax_aero.identify import excite, result, samples, verdict
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.train import identify

SPARROW = CONFIGS / "robot" / "sparrow.toml"
WIDTHS = Perturbation(
    drag=0.2, mass=0.1, com=0.02, inertia=0.2, thrust_axis_deg=2.0, thrust_gain=0.1, imu_deg=2.0, encoders_deg=2.0,
    friction=2.0,
)  # fmt: skip
COUNT, PERIOD = 120, 0.05


@pytest.fixture(scope="module")
def sparrow():
    robot = load_robot(SPARROW)
    return robot, Axisymmetric(0.6, next(iter(robot.aero_links.coefficients.values())))


def made_log(robot, aero, numbers):
    """Return samples of any motion, with the base's accelerations and the torques that these numbers ask for."""
    rng, time = np.random.default_rng(3), PERIOD * np.arange(COUNT)
    jets, joints = robot.jets.count, robot.n_joints

    def waves(size, *shape):
        entries = int(np.prod(shape))
        phase, rate = rng.uniform(0, 6, (4, entries)), rng.uniform(0.5, 6, (4, entries))
        return jnp.asarray(size * np.sin(rate * time[:, None, None] + phase).mean(1).reshape(COUNT, *shape))

    first = identify.Samples(
        weight=np.ones(COUNT), position_rate=np.zeros((COUNT, 3)), feet=np.zeros((COUNT, 6 + joints)),
        rotation=jax.vmap(exp_so3)(waves(0.6, 3)), linear_velocity=waves(1.0, 3), linear_acceleration=waves(0.0, 3),
        gyro=waves(0.8, 3), gyro_rate=waves(0.0, 3), joint_position=waves(0.8, joints),
        joint_velocity=waves(1.0, joints), joint_acceleration=waves(2.0, joints),
        thrust=0.3 * robot.jets.thrust_max + waves(0.3, jets) * robot.jets.thrust_max, thrust_rate=waves(200.0, jets),
        torque=waves(0.0, joints), torque_rate=waves(20.0, joints), wind=waves(8.0, 3),
    )  # fmt: skip
    left = identify.unexplained(robot, aero, numbers, first)
    error = verdict.accelerations(identify.mass_matrices(robot, aero, numbers, first), left)
    turned = jnp.einsum("kba,kb->ka", first.rotation @ exp_so3(-numbers.imu), error[:, 3:6])
    moved = first._replace(linear_acceleration=-error[:, :3], gyro_rate=-turned)
    left = identify.unexplained(robot, aero, numbers, moved)
    np.testing.assert_allclose(left[:, :6], 0.0, atol=1e-9)
    return moved._replace(torque=left[:, 6:])


def drawn(robot, *names):
    """Return prior deviations, and numbers of which those of these names differ from the file by about as much."""
    prior, rng = command.prior_of(robot, WIDTHS), np.random.default_rng(5)
    parts = {name: np.asarray(part) * rng.uniform(0.5, 1.5, np.shape(part)) for name, part in prior._asdict().items()}
    return prior, identify.Numbers(**{key: jnp.asarray(part * float(key in names)) for key, part in parts.items()})


@pytest.mark.usefixtures("x64")
def test_every_number_is_recovered_from_a_made_log(sparrow, monkeypatch):
    """Without noise the truth is found, of all numbers at once, to a twentieth of what was known before."""
    monkeypatch.setattr(identify, "AIR", (0.0, 0.0))
    monkeypatch.setattr(identify, "COHERENT", 0.0)
    robot, aero = sparrow
    prior, truth = drawn(robot, *identify.Numbers._fields)
    log = made_log(robot, aero, truth)
    mass = float(np.sum(robot.masses)) * float(1.0 + truth.mass)
    found = identify.estimate(robot, aero, [log], PERIOD, prior, (mass, 1e-3), (1e-4, 1e-4, 1e-4))
    wanted = np.concatenate([np.ravel(part) for part in truth])
    free = found.prior > 0.0  # the wind was measured
    error = np.abs(found.value - wanted)[free] / found.prior[free]
    names = [label for (label, *_), chosen in zip(command.labels(robot), free, strict=True) if chosen]
    rows = zip(names, error, found.share[free], strict=True)
    assert {name: (e, s) for name, e, s in rows if e > 0.05 or s < 0.95} == {}
    before, after = found.residuals[0]
    assert np.mean(after[:, :6] ** 2) < 1e-4 * np.mean(before[:, :6] ** 2)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", ["com", "thrust_gain", "thrust_axes", "imu", "encoders", "friction"])
def test_a_wrong_sign_leaves_more_unexplained_than_none(name, sparrow):
    robot, aero = sparrow
    _, truth = drawn(robot, name)
    log = made_log(robot, aero, truth)

    def left(factor):
        guess = truth._replace(**{name: factor * getattr(truth, name)})
        return float(jnp.mean(identify.unexplained(robot, aero, guess, log) ** 2))

    assert left(1.0) < 1e-12 < left(0.0) < left(-1.0)


@pytest.mark.usefixtures("x64")
def test_a_robot_that_hovers_still_adds_nothing_to_its_prior(sparrow):
    """One posture and one attitude: six equations in the mean, so that most directions keep their prior."""
    robot, aero = sparrow
    _, truth = drawn(robot, "mass")
    log = made_log(robot, aero, truth)
    still = identify.Samples(*(jnp.tile(rows[:1], (COUNT, *(1,) * (rows.ndim - 1))) for rows in log))
    prior = command.prior_of(robot, WIDTHS)
    found = identify.estimate(robot, aero, [still], PERIOD, prior)
    assert [share for share, _ in found.undetermined() if share < 0.99] == []
    assert found.deviation.max() <= max(np.max(part) for part in prior)


@pytest.mark.usefixtures("x64")
def test_what_a_log_is_expected_to_add_is_what_it_adds(sparrow):
    """With the noise that the first log left, the second one's deviations are those of an estimate from both."""
    robot, aero = sparrow
    prior, truth = drawn(robot)
    rng = np.random.default_rng(7)
    noise = np.sqrt(identify.unmodelled_variance(robot, np.zeros((1, 6 + robot.n_joints))))[0]
    logs = []
    for _ in range(2):
        log = made_log(robot, aero, truth)
        logs.append(log._replace(torque=log.torque + noise[6:] * rng.normal(size=log.torque.shape)))
    still = logs[1]._replace(joint_velocity=jnp.zeros_like(logs[1].joint_velocity))
    first, both = (identify.estimate(robot, aero, some, PERIOD, prior) for some in (logs[:1], logs))
    numbers = command.numbers_of(robot, first.value)
    left, nothing = (identify.expected(robot, aero, numbers, first, log, PERIOD) for log in (logs[1], still))
    free = first.prior > 0.0
    assert np.all(left[free] < first.deviation[free])
    assert np.exp(np.mean(np.abs(np.log(left[free] / both.deviation[free])))) < 1.2
    of_friction = [name.startswith("friction") for name, *_ in command.labels(robot)]
    assert np.all(nothing[of_friction] > 0.95 * first.deviation[of_friction])
    assert np.all(left[of_friction] < 0.9 * first.deviation[of_friction])


@pytest.mark.usefixtures("x64")
def test_numbers_that_are_not_asked_for_stay_uncertain(sparrow):
    """`--only` chooses what is shown: with the others fixed at the file's errors the intervals would be too narrow."""
    robot, aero = sparrow
    prior, truth = drawn(robot, "mass", "com")
    found = identify.estimate(robot, aero, [made_log(robot, aero, truth)], PERIOD, prior)
    shown = command.records(robot, found, command._places(robot, found, ["axes"]))
    assert {row["name"].split(".")[0] for row in shown} == {"thrust_axes"}
    assert len(shown) == 2 * robot.jets.count


def test_an_interval_of_what_is_not_known_is_that_of_the_prior(sparrow):
    """95 % of a uniform distribution, of friction from zero; with data, that of their normal distribution."""
    robot, _ = sparrow
    prior = np.concatenate([np.ravel(part) for part in command.prior_of(robot, WIDTHS)])
    names = [name for name, *_ in command.labels(robot)]

    def interval(name, value, deviation):
        place = names.index(name)
        values, deviations = np.zeros(prior.size), prior.copy()
        values[place], deviations[place] = value, deviation
        found = identify.Found(values, deviations, prior, np.diag(deviations**2), [], [])
        return [ends[place] for ends in command.intervals(robot, found)]

    assert interval("com.x", 0.0, 0.02 / np.sqrt(3.0)) == pytest.approx([-0.019, 0.019], rel=1e-3)
    assert interval("friction.waist", 0.0, 2.0 / np.sqrt(3.0)) == pytest.approx([0.05, 1.95], rel=1e-3)
    assert interval("com.x", 0.003, 1e-4) == pytest.approx([0.003 - 1.96e-4, 0.003 + 1.96e-4], rel=1e-3)
    # Beyond the file's stated error the data alone count.
    assert interval("com.x", 0.03, 1e-3) == pytest.approx([0.03 - 1.96e-3, 0.03 + 1.96e-3], rel=1e-3)


def test_the_file_flies_with_what_was_found(sparrow, tmp_path):
    """Masses, the base's centre of mass and thrust axes of the file are those of the numbers."""
    robot, _ = sparrow
    _, axes = drawn(robot, "thrust_axes")
    numbers = axes._replace(mass=jnp.array(0.05), com=jnp.array([0.01, -0.02, 0.005]))
    path = result.write_robot(tmp_path, SPARROW, robot, numbers, ["a note"])
    assert tomllib.loads(path.read_text())["base"] == str(SPARROW)
    written, expected = load_robot(path), identify.robot_with(robot, numbers)
    np.testing.assert_allclose(written.masses, expected.masses, rtol=1e-9)
    np.testing.assert_allclose(written.coms, expected.coms, atol=1e-7)
    np.testing.assert_allclose(written.jets.axes, expected.jets.axes, atol=1e-6)
    np.testing.assert_allclose(written.inertias[1:], expected.inertias[1:], rtol=1e-6, atol=1e-9)
    plate = load_robot(SPARROW.with_name("platform.toml"))
    numbers = drawn(plate, "inertia")[1]
    path = result.write_robot(tmp_path, Path(plate.source), plate, numbers, [])
    np.testing.assert_allclose(load_robot(path).inertias, (1.0 + numbers.inertia) * plate.inertias, rtol=1e-6)


def test_a_root_without_a_mass_leaves_the_offset_to_its_heaviest_link(tmp_path):
    """The base body's centre of mass moves as found, in the axes of a link that is turned in it."""
    source = tmp_path / "source"
    source.mkdir()
    platform = SPARROW.with_name("platform.toml")
    urdf = (
        platform.with_suffix(".urdf")
        .read_text()
        .replace(
            '<link name="plate">',
            '<link name="frame"/><joint name="root" type="fixed"><parent link="frame"/><child link="plate"/>'
            '<origin xyz="0 0 0.1" rpy="0 0 1.2"/></joint><link name="plate">',
        )
    )
    (source / "plate.urdf").write_text(urdf)
    table = {"base": str(platform), "urdf": "plate.urdf", "base_link": "frame"}
    (source / "plate.toml").write_text(plain.toml(table) + "\n")
    robot = load_robot(source / "plate.toml")
    numbers = drawn(robot, "com")[1]
    path = result.write_robot(tmp_path, source / "plate.toml", robot, numbers, [])
    np.testing.assert_allclose(load_robot(path).coms[0] - robot.coms[0], numbers.com, atol=1e-8)


def test_smoothing_is_exact_for_a_parabola(agree):
    """Value, slope and curvature of 3 + 2 t + t², the first raised by the square of the Gaussian's width."""
    time = 0.01 * np.arange(400)
    rows, at = (3.0 + 2.0 * time + time**2)[:, None], np.array([1.513, 2.0])
    agree("value", samples._smooth(time, rows, at, 0)[:, 0], 3.0 + 2.0 * at + at**2 + samples.WIDTH**2, 1e-4)
    agree("slope", samples._smooth(time, rows, at, 1)[:, 0], 2.0 + 2.0 * at, 1e-3)
    agree("curvature", samples._smooth(time, rows, at, 2)[:, 0], [2.0, 2.0], 1e-3)


def test_a_manoeuvre_moves_its_axes_alone():
    rows = excite.reference(np.array([1.0, 2.0, 3.0]), np.zeros(3), ["z", "yaw"], 4.0, 30.0)
    moved = np.ptp(rows[:, 1:], axis=0)
    assert moved[[0, 1, 3, 4]].tolist() == [0.0] * 4
    assert 0.3 < moved[2] <= 2.0 * excite.AXES["z"]
    assert np.radians(20.0) < moved[5] <= np.radians(2.0 * excite.AXES["yaw"])
    np.testing.assert_array_equal(rows[[0, -1], 1:], np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.0], (2, 1)))


def test_a_drawn_robot_differs_in_what_its_file_does_not_state():
    config = rust.load_config("robot")
    robot = rust.Robot(config["robot"])
    widths = Perturbation(thrust_gain=0.1, imu_deg=2.0, encoders_deg=2.0, latency=0.003, friction=2.0)
    widths.apply(config, 1, 0, robot)
    simulator = config["simulator"]
    gains = np.array(list(config["disturbances"]["jets"]["force_scale"].values()))
    assert 0.0 < np.abs(gains - 1.0).min() < np.abs(gains - 1.0).max() < 0.1
    friction = np.array(list(simulator["motors"]["friction_of"].values()))
    assert len(friction) == len(robot.joint_names)
    assert np.all((friction >= 0.0) & (friction <= 2.0))
    assert np.all(np.abs(simulator["sensors"]["joints"]["bias"]) < np.radians(2.0))
    assert simulator["actuation"]["torque_delay"] in np.round(np.arange(2, 9) * 0.001, 6)
    rust.resolve_config(config)


def test_from_a_log_to_a_flight(tmp_path, monkeypatch):
    """A flight of the platform is identified, and the robot that this makes flies by its name."""
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert fly.main(["platform_hover", "--set", "simulator.duration=6", "--out", str(tmp_path), "--name", "log"]) == 0
    words = [str(tmp_path / "log"), "--mass", "18.0"]
    monkeypatch.setattr(excite, "AXES", {"z": 0.3})
    assert command.main([*words, "--propose"]) == 0
    folder = tmp_path / "identify" / "log"
    assert {path.name for path in folder.iterdir()} == {
        "robot.toml", "robot.urdf", "experiment.toml", "perturbation.toml", "numbers.json", "held_out.png"
    }  # fmt: skip
    left = tables.load(folder / "perturbation.toml", Perturbation)
    assert 0.0 < left.mass < 0.1
    facts = json.loads((folder / "numbers.json").read_text())
    assert facts["explained"]
    assert facts["wind"] == "measured"
    mass = facts["numbers"][0]
    assert (mass["name"], mass["unit"], mass["found"]) == ("mass", "%", True)
    assert mass["interval"][0] < mass["value"] < mass["interval"][1]
    assert mass["prior"] == pytest.approx(10.0 / np.sqrt(3.0))
    assert {row["name"] for row in facts["held_out"]} > {"acceleration x", "velocity z", "turning ry"}
    again = rust.load_config(folder / "experiment.toml", {"simulator.duration": 1.0})
    assert Path(again["robot"]) == folder / "robot.toml"
    assert rust.fly(again).outcome == "completed"
    assert command.main(["--excite", "z", "--experiment", "platform_hover"]) == 0
    mission = rust.load_config(tmp_path / "identify" / "excite_z" / "excite.toml", {"simulator.duration": 1.0})
    assert rust.fly(mission).outcome == "completed"
    assert command.main([*words, "--overwrite", "--only", "mases"]) == 2
    assert command.main([*words[:2], "18000", "--overwrite"]) == 2
    assert command.main(words) == 2  # the result exists
