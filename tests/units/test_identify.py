"""A robot's numbers from made-up logs, whose motion follows its equations with other numbers than those of its file."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import Axisymmetric, NoAero
from jax_aero.base import places, plain_values, tables
from jax_aero.base.places import CONFIGS
from jax_aero.body.dynamics import dynamics
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import exp_so3
from jax_aero.commands import fly
from jax_aero.commands import identify as command
from jax_aero.identify import excite, motion, result, samples, search, verdict
from jax_aero.identify.numbers import MANY, Z, estimates, labels, records
from jax_aero.identify.prior import BODIES, numbers_of, prior_of
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.types import State

SPARROW = CONFIGS / "robot" / "sparrow.toml"
WIDTHS = Perturbation(
    drag=0.2, mass=0.1, com=0.02, inertia=0.2, thrust_axis_deg=2.0, thrust_gain=0.1, imu_deg=2.0, encoders_deg=2.0,
    friction=2.0,
)  # fmt: skip
COUNT, PERIOD = 120, 0.05


@pytest.fixture(scope="module")
def sparrow():
    robot = load_robot(SPARROW)
    aero = Axisymmetric(0.6, next(iter(robot.aero_links.coefficients.values())))
    return motion.Model(robot, aero, 0.3 * np.ones(robot.n_joints))


def made_log(model, numbers):
    """Return samples of any motion, with the base's accelerations and the torques that these numbers ask for."""
    rng, time, robot = np.random.default_rng(3), PERIOD * np.arange(COUNT), model.robot
    jets, joints = robot.jets.count, robot.n_joints

    def waves(size, *shape):
        entries = int(np.prod(shape))
        phase, rate = rng.uniform(0, 6, (4, entries)), rng.uniform(0.5, 6, (4, entries))
        return jnp.asarray(size * np.sin(rate * time[:, None, None] + phase).mean(1).reshape(COUNT, *shape))

    first = motion.Samples(
        weight=np.ones(COUNT), burnt=400.0 * time, position_rate=np.zeros((COUNT, 3)),
        turn_rate=np.zeros((COUNT, 3)), feet=np.zeros((COUNT, 6 + joints)),
        rotation=jax.vmap(exp_so3)(waves(0.6, 3)), linear_velocity=waves(1.0, 3), linear_acceleration=waves(0.0, 3),
        gyro=waves(0.8, 3), gyro_rate=waves(0.0, 3), joint_position=waves(0.8, joints),
        joint_velocity=waves(1.0, joints), joint_acceleration=waves(2.0, joints),
        thrust=0.3 * robot.jets.thrust_max + waves(0.3, jets) * robot.jets.thrust_max, thrust_rate=waves(200.0, jets),
        thrust_noise=np.zeros((COUNT, jets)), velocity_noise=np.zeros((COUNT, 6)),
        torque=waves(0.0, joints), torque_rate=waves(20.0, joints), wind=waves(8.0, 3),
    )  # fmt: skip
    left = motion.unexplained(model, numbers, first)
    error = verdict.accelerations(motion.mass_matrices(model, numbers, first), left)
    turned = jnp.einsum("kba,kb->ka", first.rotation @ exp_so3(-numbers.imu) @ exp_so3(-numbers.gyro), error[:, 3:6])
    moved = first._replace(linear_acceleration=-error[:, :3], gyro_rate=-turned)
    left = motion.unexplained(model, numbers, moved)
    np.testing.assert_allclose(left[:, :6], 0.0, atol=1e-9)
    # What the drives give is 1 + gain times the measured torque, less delay and friction, which are in `left`.
    gains = 1.0 + motion.of_joints(robot, numbers.torque_gain)
    return moved._replace(torque=left[:, 6:] * (1.0 + numbers.mass) / gains)


def drawn(robot, *names):
    """Return prior deviations, and numbers of which those of these names differ from the file by about as much."""
    prior, rng = prior_of(robot, WIDTHS), np.random.default_rng(5)
    parts = {name: np.asarray(part) * rng.uniform(0.5, 1.5, np.shape(part)) for name, part in prior._asdict().items()}
    return prior, motion.Numbers(**{key: jnp.asarray(part * float(key in names)) for key, part in parts.items()})


def errors_of(model, prior, truth, monkeypatch):
    """Return found numbers, and by name how many prior deviations they are off and the share of the data."""
    monkeypatch.setattr(motion, "AIR", (0.0, 0.0, 0.0))
    for name in ("COHERENT", "COHERENT_INERTIA", "LATE"):
        monkeypatch.setattr(search, name, 0.0)
    log = made_log(model, truth)
    mass = float(np.sum(model.robot.masses)) * float(1.0 + truth.mass)
    found = search.estimate(model, [log], PERIOD, prior, (mass, 1e-3), (1e-4, 1e-4, 1e-4))
    wanted = np.concatenate([np.ravel(part) for part in truth])
    free = found.prior > 0.0  # the wind was measured
    error = np.abs(found.value - wanted)[free] / found.prior[free]
    names = [label for (label, *_), chosen in zip(labels(model.robot), free, strict=True) if chosen]
    return found, dict(zip(names, zip(error, found.share[free], strict=True), strict=True))


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_every_number_is_recovered_from_a_made_log(sparrow, monkeypatch):
    """Without noise the truth is found, of all numbers at once, to a twentieth of what was known before."""
    fields = [name for name in motion.Numbers._fields if name not in (*MANY, "wind")]
    prior, truth = drawn(sparrow.robot, *fields)
    prior = prior._replace(**{name: np.zeros_like(getattr(prior, name)) for name in (*MANY, "wind")})
    found, errors = errors_of(sparrow, prior, truth, monkeypatch)
    # The gyroscope's rotation was known to 0.05 degrees.
    asked = {name: part for name, part in errors.items() if not name.startswith("gyro")}
    assert {name: (e, s) for name, (e, s) in asked.items() if e > 0.05 or s < 0.95} == {}
    assert found.moved < 0.5
    before, after = found.residuals[0]
    assert np.mean(after[:, :6] ** 2) < 1e-4 * np.mean(before[:, :6] ** 2)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("kind", ["thrust", "accelerations"])
def test_noise_that_multiplies_numbers_does_not_make_them_small(kind, sparrow, monkeypatch):
    """Noise of thrusts or accelerations, taken as none, makes gains or arms small; where it is known it does not.

    The mean with noise and with its negative is free of what is odd in it.
    """
    for name in ("AIR", "UNMODELLED"):
        monkeypatch.setattr(motion, name, (0.0, 0.0, 0.0))
    prior, truth = drawn(sparrow.robot)
    asked = {"thrust": ("thrust_gain", "thrust_offset"), "accelerations": ("com",)}[kind]
    prior = prior._replace(**{name: np.zeros_like(part) for name, part in prior._asdict().items() if name not in asked})
    log, rng = made_log(sparrow, truth), np.random.default_rng(4)
    if kind == "thrust":
        size = 0.15 * np.std(np.asarray(log.thrust), axis=0)
        noise, field = size * rng.normal(size=log.thrust.shape), "thrust"
        known = {"thrust_noise": np.tile(size, (COUNT, 1))}
    else:
        # Derivatives of white noise of the rates, as they are smoothed.
        rates = 2.0 * np.pi * np.fft.rfftfreq(COUNT, PERIOD)[:, None]
        white = np.fft.rfft(0.2 * rng.normal(size=(COUNT, 3)), axis=0)
        smooth = 1j * rates * np.exp(-0.5 * (rates * motion.WIDTH) ** 2) * white
        noise, field = np.fft.irfft(smooth, COUNT, axis=0), "gyro_rate"
        known = {"velocity_noise": np.tile(np.repeat([0.0, 0.2], 3), (COUNT, 1))}

    def shift(**more):
        found = []
        for sign in (1.0, -1.0):
            one = log._replace(**{field: getattr(log, field) + sign * noise}, **more)
            value = search.estimate(sparrow, [one], PERIOD, prior, None, (1e-4, 1e-4, 1e-4)).value
            numbers = numbers_of(sparrow.robot, value)
            found.append(np.mean(numbers.thrust_gain) if kind == "thrust" else numbers.com[2])
        return float(np.mean(found))

    assert shift() < 0.0
    assert abs(shift(**known)) < 0.5 * abs(shift())


@pytest.mark.usefixtures("x64")
def test_drives_that_are_wrong_alike_do_not_make_the_robot_light(sparrow, monkeypatch):
    """Without a weighing its mass is known as well as all torques are together, which are a tenth too small."""
    asked = ("mass", "thrust_gain", "torque_gain", "air")
    prior, truth = drawn(sparrow.robot)
    truth = truth._replace(torque_gain=jnp.full_like(truth.torque_gain, 0.1))
    prior = prior._replace(**{name: np.zeros_like(part) for name, part in prior._asdict().items() if name not in asked})
    log = made_log(sparrow, truth)
    found = search.estimate(sparrow, [log], PERIOD, prior)
    assert abs(found.value[0]) < Z * found.deviation[0]
    monkeypatch.setattr(search, "ALIKE", 0.0)
    assert search.estimate(sparrow, [log], PERIOD, prior).deviation[0] < 0.97 * found.deviation[0]


@pytest.mark.usefixtures("x64")
def test_bodies_that_differ_one_by_one_do_not_mislead(sparrow, monkeypatch):
    """Masses, centres and sizes of bodies beside what the robot has in common: intervals of all hold the truth."""
    prior, truth = drawn(sparrow.robot, "mass", "com", "inertia", "bodies", "torque_gain")
    still = ("air", "air_turn", "air_point", "wind")
    prior = prior._replace(**{name: np.zeros_like(getattr(prior, name)) for name in still})
    found, _ = errors_of(sparrow, prior, truth, monkeypatch)
    free = found.prior > 0.0
    wanted = np.concatenate([np.ravel(part) for part in truth])
    beyond = (np.abs(found.value - wanted) > 2.6 * found.deviation)[free]
    assert beyond.mean() < 0.05
    heavy = [name.startswith(("bodies.", "com")) for name, *_ in labels(sparrow.robot)]
    assert np.sum(found.share[heavy] > 0.5) > 5


@pytest.mark.usefixtures("x64")
def test_bodies_keep_mass_centre_and_inertia_of_the_whole(sparrow):
    """What `mass`, `com` and `inertia` say of the robot in its posture does not depend on how bodies share it."""
    rng, robot = np.random.default_rng(1), sparrow.robot
    none = numbers_of(robot, np.zeros(sum(np.size(part) for part in prior_of(robot, WIDTHS))))
    some = none._replace(mass=np.array(0.03), com=np.array([0.01, -0.02, 0.005]), inertia=np.array(-0.1))
    other = some._replace(bodies=np.repeat(BODIES, [1, 3, 6]) * rng.normal(size=np.shape(none.bodies)))
    wholes = []
    for numbers in (some, other):
        changed = motion.robot_with(sparrow, numbers)
        kin = kinematics_at_rest(changed, jnp.asarray(sparrow.posture))
        matrix = dynamics(changed, State(jnp.zeros(3), jnp.eye(3), jnp.asarray(sparrow.posture), jnp.zeros(11)), kin)
        wholes.append((changed.mass, kin.com, jnp.trace(matrix.centroidal_inertia)))
        # Second moments of a body are as physical as the file's.
        signs = [np.sign(np.linalg.eigvalsh(motion._opposite(each.inertias, 0.5))) for each in (robot, changed)]
        np.testing.assert_array_equal(*signs)
    for one, same in zip(*wholes, strict=True):
        np.testing.assert_allclose(one, same, rtol=1e-9, atol=1e-12)
    assert not np.allclose(motion.robot_with(sparrow, some).masses, motion.robot_with(sparrow, other).masses)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "name",
    [
        "com",
        "fuel",
        "thrust_gain",
        "torque_gain",
        "thrust_axes",
        "imu",
        "gyro",
        "encoders",
        "friction",
        "air_turn",
        "air_point",
    ],
)
def test_a_wrong_sign_leaves_more_unexplained_than_none(name, sparrow):
    robot = sparrow.robot
    _, truth = drawn(robot, name)
    log = made_log(sparrow, truth)

    def left(factor):
        guess = truth._replace(**{name: factor * getattr(truth, name)})
        return float(jnp.mean(motion.unexplained(sparrow, guess, log) ** 2))

    assert left(1.0) < 1e-12 < left(0.0) < left(-1.0)


@pytest.mark.usefixtures("x64")
def test_a_robot_that_hovers_still_adds_nothing_to_its_prior(sparrow):
    """One posture and one attitude: six equations in the mean, so that most directions keep their prior."""
    robot = sparrow.robot
    _, truth = drawn(robot, "mass")
    log = made_log(sparrow, truth)
    still = motion.Samples(*(jnp.tile(rows[:1], (COUNT, *(1,) * (rows.ndim - 1))) for rows in log))
    prior = prior_of(robot, WIDTHS)
    found = search.estimate(sparrow, [still], PERIOD, prior)
    assert [share for share, _ in found.undetermined() if share < 0.99] == []
    assert found.deviation.max() <= max(np.max(part) for part in prior)


@pytest.mark.usefixtures("x64")
def test_what_a_log_is_expected_to_add_is_what_it_adds(sparrow):
    """With the noise that the first log left, the second one's deviations are those of an estimate from both."""
    robot = sparrow.robot
    prior, truth = drawn(robot)
    rng = np.random.default_rng(7)
    noise = np.sqrt(motion.unmodelled_variance(robot, np.zeros((1, 6 + robot.n_joints))))[0]
    logs = []
    for _ in range(2):
        log = made_log(sparrow, truth)
        logs.append(log._replace(torque=log.torque + noise[6:] * rng.normal(size=log.torque.shape)))
    still = logs[1]._replace(joint_velocity=jnp.zeros_like(logs[1].joint_velocity))
    first, both = (search.estimate(sparrow, some, PERIOD, prior) for some in (logs[:1], logs))
    numbers = numbers_of(robot, first.value)
    left, nothing = (search.expected(sparrow, numbers, first, log, PERIOD) for log in (logs[1], still))
    free = first.prior > 0.0
    assert np.all(left[free] <= first.deviation[free] * (1.0 + 1e-9))  # of what no log shows as it was
    assert np.exp(np.mean(np.abs(np.log(left[free] / both.deviation[free])))) < 1.2
    of_friction = [name.startswith("friction") for name, *_ in labels(robot)]
    assert np.all(nothing[of_friction] > 0.95 * first.deviation[of_friction])
    assert np.all(left[of_friction] < 0.9 * first.deviation[of_friction])


@pytest.mark.usefixtures("x64")
def test_numbers_that_are_not_asked_for_stay_uncertain(sparrow):
    """`--only` chooses what is shown: with the others fixed at the file's errors the intervals would be too narrow."""
    robot = sparrow.robot
    prior, truth = drawn(robot, "mass", "com")
    found = search.estimate(sparrow, [made_log(sparrow, truth)], PERIOD, prior)
    shown = records(robot, found, command._places(robot, found, ["axes"]))
    assert {row["name"].split(".")[0] for row in shown} == {"thrust_axes"}
    assert len(shown) == 2 * robot.jets.count


def test_an_interval_of_what_is_not_known_is_that_of_the_prior(sparrow):
    """95 % of a uniform distribution, of friction from zero; with data, that of their normal distribution."""
    robot = sparrow.robot
    prior = np.concatenate([np.ravel(part) for part in prior_of(robot, WIDTHS)])
    names = [name for name, *_ in labels(robot)]

    def interval(name, value, deviation):
        place = names.index(name)
        values, deviations = np.zeros(prior.size), prior.copy()
        values[place], deviations[place] = value, deviation
        found = search.Found(values, deviations, prior, np.diag(deviations**2), [], [])
        return [ends[place] for ends in estimates(robot, found)[::2]]

    half = np.sqrt(3.0) * prior[names.index("com.x")]
    assert half > 0.02  # of the file's base body, and of what other bodies may weigh
    assert interval("com.x", 0.0, half / np.sqrt(3.0)) == pytest.approx([-0.95 * half, 0.95 * half], rel=1e-3)
    assert interval("friction.waist", 0.0, 2.0 / np.sqrt(3.0)) == pytest.approx([0.05, 1.95], rel=1e-3)
    assert interval("com.x", 0.003, 1e-4) == pytest.approx([0.003 - 1.96e-4, 0.003 + 1.96e-4], rel=1e-3)
    # Beyond the file's stated error the data alone count.
    assert interval("com.x", half + 0.01, 1e-3) == pytest.approx(
        half + 0.01 + 1.96e-3 * np.array([-1.0, 1.0]), rel=1e-3
    )


@pytest.mark.usefixtures("x64")
def test_the_file_flies_with_what_was_found(sparrow, tmp_path):
    """Masses, the base's centre of mass and thrust axes of the file are those of the numbers."""
    robot = sparrow.robot
    _, axes = drawn(robot, "thrust_axes")
    numbers = axes._replace(mass=jnp.array(0.05), com=jnp.array([0.01, -0.02, 0.005]))
    path = result.write_robot(tmp_path, SPARROW, sparrow, numbers, ["a note"])
    assert tomllib.loads(path.read_text())["base"] == str(SPARROW)
    written, expected = load_robot(path), motion.robot_with(sparrow, numbers)
    np.testing.assert_allclose(written.masses, expected.masses, rtol=1e-9)
    np.testing.assert_allclose(written.coms, expected.coms, atol=1e-7)
    np.testing.assert_allclose(written.jets.axes, expected.jets.axes, atol=1e-6)
    np.testing.assert_allclose(written.inertias[1:], expected.inertias[1:], rtol=1e-6, atol=1e-9)
    plate = load_robot(SPARROW.with_name("platform.toml"))
    numbers = drawn(plate, "inertia")[1]
    model = motion.Model(plate, sparrow.aero, np.zeros(0))
    path = result.write_robot(tmp_path, Path(plate.source), model, numbers, [])
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
    (source / "plate.toml").write_text(plain_values.toml(table) + "\n")
    robot = load_robot(source / "plate.toml")
    numbers = drawn(robot, "com")[1]
    model = motion.Model(robot, NoAero(), np.zeros(0))
    path = result.write_robot(tmp_path, source / "plate.toml", model, numbers, [])
    np.testing.assert_allclose(load_robot(path).coms[0] - robot.coms[0], numbers.com, atol=1e-8)


def rows_at(time):
    """Return a log of two signals that are linear in time."""
    turned = np.tile(np.eye(3), (time.size, 1, 1))
    return {"time": time, "raw_thrust": np.stack([time, 2.0 * time], axis=1), "raw_base_rotation": turned}


def test_uneven_rows_are_those_of_even_times():
    """Jittered, doubled and lost rows of a line are the line; a gap that no smoothing bridges is not a number."""
    rng, time = np.random.default_rng(0), 0.01 * np.arange(1000)
    uneven = time + np.r_[0.0, rng.uniform(-0.004, 0.004, 998), 0.0]
    doubled = np.sort(np.r_[uneven, uneven[::20]])
    lost = np.delete(doubled, rng.choice(900, 90, replace=False) + 20)
    for stamps in (uneven, doubled, lost):
        found = samples.even(rows_at(stamps))
        np.testing.assert_allclose(np.diff(found["time"]), np.diff(found["time"])[0], rtol=1e-9)
        known = np.isfinite(found["raw_thrust"]).all(axis=1)
        assert known.mean() > 0.99
        np.testing.assert_allclose(found["raw_thrust"][known][:, 1], 2.0 * found["time"][known], atol=1e-9)
    gone = samples.even(rows_at(np.delete(time, np.arange(400, 430))))
    assert 25 <= np.isnan(gone["raw_thrust"][:, 0]).sum() <= 31
    holes = rows_at(time)
    holes["raw_thrust"][[100, 300]] = np.nan
    assert np.isfinite(samples.even(holes)["raw_thrust"]).all()


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


@pytest.mark.slow
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
    for row in facts["numbers"]:
        assert row["interval"][0] <= row["value"] <= row["interval"][1]
    assert command.main(["--excite", "z", "--experiment", "platform_hover"]) == 0
    excited = rust.load_config(tmp_path / "identify" / "excite_z" / "excite.toml")
    assert excited["wind"] == {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}
    mission = rust.load_config(tmp_path / "identify" / "excite_z" / "excite.toml", {"simulator.duration": 1.0})
    assert rust.fly(mission).outcome == "completed"
    assert command.main([*words, "--overwrite", "--only", "mases"]) == 2
    assert command.main([*words[:2], "18000", "--overwrite"]) == 2
    assert command.main(words) == 2  # the result exists


def test_what_was_not_found_of_drives_stays_as_stated(sparrow, tmp_path):
    """A joint that did not move has the file's friction in the world, and its group the controller's."""
    robot = load_robot(CONFIGS / "robot" / "ironcub_mk1.toml")
    config = rust.load_config("robot")
    zero = np.zeros(sum(np.size(part) for part in prior_of(robot, WIDTHS)))
    numbers = numbers_of(robot, zero)
    friction, arm = np.zeros(robot.n_joints), robot.joint_names.index("l_elbow")
    friction[arm] = 1.5
    is_found = numbers._replace(friction=(friction > 0.0).astype(float), damping=np.array(1.0))
    numbers = numbers._replace(friction=friction, damping=np.array(0.2))
    result.write_experiment(tmp_path, config, robot, numbers, is_found)
    written = tomllib.loads((tmp_path / "experiment.toml").read_text())
    drives = written["simulator"]["motors"]
    stated = config["simulator"]["motors"]["friction"]
    assert drives["friction_of"] == {name: 1.5 if name == "l_elbow" else stated for name in robot.joint_names}
    assert drives["damping"] == 0.2
    known, before = written["controller"]["torque"]["friction"], config["controller"]["torque"]["friction"]
    assert known.keys() == before.keys()
    assert [group for group in known if known[group] != before[group]] == ["left_arm"]
