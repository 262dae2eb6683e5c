"""Logs that a robot's model does not explain, and samples that its equations do not cover."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.body.robot import load_robot
from jax_aero.body.spatial import exp_so3, wxyz_from_rotation
from jax_aero.identify import samples, verdict
from jax_aero.identify.identified import identify_robot, mistake
from jax_aero.identify.numbers import estimates, labels
from jax_aero.identify.prior import WIND, prior_of
from jax_aero.sweep.perturbation import Perturbation
from tests.units import test_any_robot

SENSORS = {
    "seed": 1, "base_position": {"noise_std": 0.005}, "base_linear_velocity": {"noise_std": 0.02},
    "base_rotation": {"noise_std": 0.002}, "base_angular_velocity": {"noise_std": 0.005},
    "joints": {"resolution": 0.0015}, "thrust": {"noise_std": 0.3},
}  # fmt: skip
WIDTHS = Perturbation(
    drag=0.2, mass=0.1, com=0.02, inertia=0.2, thrust_axis_deg=2.0, thrust_gain=0.1, imu_deg=2.0, encoders_deg=2.0,
    friction=2.0,
)  # fmt: skip
FLIP = np.diag([1.0, -1.0, -1.0])
SWAPPED = [0, 1, 3, 2, 4]


@pytest.fixture(scope="module")
def flown():
    """Configuration and log of a flight with sensors, of a robot whose file is right."""
    config = test_any_robot.sparrow()
    config["simulator"] |= {"sensors": SENSORS, "duration": 16.0}
    flight = rust.fly(config)
    assert flight.outcome == "completed"
    return config, dict(flight.log)


def identified(config, log):
    source = Path(config["robot"])
    robot = load_robot(source)
    prior = prior_of(robot, WIDTHS, 0.0 if samples.is_measured(log) else WIND)
    return identify_robot(config, source, [log], prior, float(np.sum(robot.masses))), prior


def scaled(name, factor, part=slice(None)):
    def change(log):
        rows = log[name].copy()
        rows[:, part] *= factor
        return {name: rows}

    return change


def late(name):
    return lambda log: {name: np.roll(log[name], 20, axis=0)}


WRONG = {
    "thrusts in kgf": scaled("raw_thrust", 1.0 / 9.80665),
    "joint positions in degrees": scaled("raw_joint_position", np.degrees(1.0)),
    "velocities in mm/s": scaled("raw_base_velocity", 1e3, slice(3)),
    "rates of turn in deg/s": scaled("raw_base_velocity", np.degrees(1.0), slice(3, 6)),
    "quaternions as x, y, z, w": lambda log: {
        "raw_base_rotation": rust.rotation_from_wxyz(
            np.roll(np.asarray(wxyz_from_rotation(log["raw_base_rotation"])), -1, axis=1)
        )
    },
    "sign of gravity": lambda log: {
        "raw_base_rotation": FLIP @ log["raw_base_rotation"],
        "raw_base_velocity": log["raw_base_velocity"] @ np.kron(np.eye(2), FLIP),
        "raw_base_position": log["raw_base_position"] @ FLIP,
        "raw_wind": log["raw_wind"] @ FLIP,
    },
    "swapped jets back_jet and l_jet": lambda log: {"raw_thrust": log["raw_thrust"][:, [1, 0, 2]]},
    "swapped joints waist and l_shoulder": lambda log: {"raw_joint_position": log["raw_joint_position"][:, SWAPPED]},
    "swapped torques of joints waist and l_shoulder": lambda log: {"joint_torque": log["joint_torque"][:, SWAPPED]},
    "thrusts about 0.2 s late": late("raw_thrust"),
    "attitude about 0.2 s late": late("raw_base_rotation"),
    "a clock that runs 1.25 times": lambda log: {"time": 1.25 * log["time"]},
    "a load": lambda log: {"raw_thrust": 0.8 * log["raw_thrust"]},
}
"""Logs with one mistake each, by what is named."""
NAMED = (
    "thrusts in kgf",
    "quaternions as x, y, z, w",
    "sign of gravity",
    "swapped jets back_jet and l_jet",
    "a load of",
)
"""Those that are looked for, which takes seconds each."""
JUMPING = ("velocities in mm/s",)
"""Those of which too little is left."""


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_log_of_the_files_robot_is_explained(flown):
    known, _ = identified(*flown)
    assert known.verdict.unexplained == []
    assert known.verdict.is_explained
    assert known.left_out == {}


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_log_is_not_explained_and_the_mistake_is_named(flown, name):
    config, log = flown
    log = {**log, **WRONG[name](log)}
    if name in JUMPING:
        with pytest.raises(Refused, match=r"left out: .* by odometry jumps"):
            identified(config, log)
        return
    known, prior = identified(config, log)
    assert not known.verdict.is_explained
    if name in NAMED:
        source = Path(config["robot"])
        found = mistake(known, config, source, [log], prior, float(np.sum(known.robot.masses)))
        assert found is not None
        assert name in found


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_a_log_without_an_anemometer_has_a_wind_to_find(flown):
    """Still air would be 2 m/s off; of a robot that hardly drifts the wind is found from small forces."""
    config, log = flown
    known, prior = identified(config, {**log, "raw_wind": np.full_like(log["raw_wind"], np.nan)})
    assert known.verdict.is_explained
    names = [name for name, *_ in labels(known.robot)]
    place = names.index("wind.y")
    low, high = (ends[place] for ends in estimates(known.robot, known.found)[::2])
    assert prior.wind[1] == WIND
    assert low < -2.0 < high
    assert known.found.share[place] > 0.5


def left_out(flown, change):
    config, log = flown
    robot = rust.Robot(config["robot"])
    log = {name: rows.copy() for name, rows in log.items()} | {"raw_foot_wrench": np.zeros((log["time"].size, 2, 6))}
    change(log)
    _, reasons = samples.sample(samples.check(log, "log", robot), config, robot)
    return reasons


def put(name, rows, value):
    def change(log):
        log[name][rows] = value

    return change


def test_a_lost_row_of_a_standing_robot_has_no_forces_of_its_feet():
    """It is filled from its neighbours, as every signal is."""
    robot = rust.Robot(rust.load_config("test1")["robot"])
    count = len(robot.joint_names)
    log = {
        "time": 0.01 * np.arange(3), "raw_joint_position": np.zeros((3, count)), "raw_foot_wrench": np.ones((3, 2, 6)),
        "raw_base_position": np.zeros((3, 3)), "raw_base_rotation": np.tile(np.eye(3), (3, 1, 1)),
    }  # fmt: skip
    log["raw_base_rotation"][1] = np.nan
    found = samples._of_feet(log, robot)
    np.testing.assert_array_equal(np.isnan(found).all(axis=1), [False, True, False])
    np.testing.assert_allclose(found[[0, 2], :3], 2.0, rtol=1e-14)  # one newton of each foot


def jump(log):
    log["raw_base_position"][500:] += [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (put("raw_thrust", slice(500, 510), np.nan), "rows lost"),
        (put("joint_torque", slice(500, 510), np.nan), "rows lost"),
        (put("raw_thrust", (500, 1), 0.5), "engines idle"),
        (put("joint_torque", (500, 2), 1e9), "commands saturated"),
        (jump, "odometry jumps"),
        (put("raw_joint_position", (500, 0), 40.0), "joints beyond stops"),
        (put("raw_foot_wrench", 500, 50.0), "feet loaded"),
    ],
)  # fmt: skip
def test_samples_that_the_equations_do_not_cover_are_left_out_and_counted(flown, change, reason):
    """Smoothing and delays spread one row to five samples about it."""
    assert left_out(flown, dict.copy) == {}
    assert left_out(flown, change) == {reason: pytest.approx(5, abs=2)}


def coloured(rng, shape, size, time=0.1, step=0.01):
    """Return noise of a first-order filter with this time."""
    keep = np.exp(-step / time)
    found = np.zeros(shape)
    for row in range(1, shape[0]):
        found[row] = keep * found[row - 1] + size * np.sqrt(1.0 - keep**2) * rng.normal(size=shape[1:])
    return found


SENSED = {
    "a clock": lambda log: {"time": 1.01 * log["time"]},
    "attitude 20 ms later": lambda log: {
        name: np.concatenate([rows[:1]] * 2 + [rows[:-2]])
        for name, rows in {"raw_base_rotation": log["raw_base_rotation"]}.items()
    },
}


def moved():
    """Return a log of three axes in motion, seen by sensors with white noise."""
    rng, time = np.random.default_rng(2), 0.01 * np.arange(4000)
    rate = 0.3 * np.sin(2.0 * np.pi * time[:, None] / [4.0, 3.1, 2.3] + [0.0, 1.0, 2.0])
    turns = np.cumsum(np.r_[np.zeros((1, 3)), 0.005 * (rate[1:] + rate[:-1])], axis=0)
    rotation, gyro = [np.eye(3)], 0.5 * (rate[1:] + rate[:-1])
    for row in gyro:
        rotation.append(rotation[-1] @ np.asarray(exp_so3(0.01 * row)))
    rotation = np.array(rotation)
    spin = np.einsum("kab,kb->ka", rotation, rate)
    noise = rng.normal(size=(time.size, 12)) * np.repeat([0.002, 0.01, 0.002, 0.005], 3)
    return {
        "time": time, "raw_base_position": turns + noise[:, :3],
        "raw_base_rotation": rotation @ np.asarray(exp_so3(noise[:, 6:9])),
        "raw_base_velocity": np.hstack([rate + noise[:, 3:6], spin + noise[:, 9:]]),
    }  # fmt: skip


def compared(log, flown):
    config, other = flown
    robot = rust.Robot(config["robot"])
    still = {name: np.tile(rows[800], (4000, *(1,) * (rows.ndim - 1))) for name, rows in other.items()}
    whole = {name: still[name] for name in (*samples.MEASURED, "raw_wind")} | log
    with np.errstate(all="ignore"):
        one, again = (samples.sample(part, config, robot)[0] for part in (whole, samples.with_noise_again(whole)))
    return verdict.compare_rates(one, again)


def test_sensors_that_contradict_each_other_are_named(flown):
    """A clock 1 % fast makes rates slow, an attitude that is late follows the gyroscope; white noise does neither."""
    log = moved()
    sound = compared(log, flown)
    assert sound.conflicts == []
    assert np.all(sound.acceleration == 0.0)
    for name, change in SENSED.items():
        (conflict,) = compared({**log, **change(log)}, flown).conflicts
        assert name in conflict


def test_coloured_noise_is_noise(flown):
    """A filter's noise of 0.1 s goes with no motion; its derivative is what accelerations get of it."""
    log, rng = moved(), np.random.default_rng(5)
    log["raw_base_velocity"] = log["raw_base_velocity"] + coloured(rng, log["raw_base_velocity"].shape, 0.05)
    found = compared(log, flown)
    assert found.conflicts == []
    assert np.all((found.noise > 0.03) & (found.noise < 0.07))
    assert np.all((found.acceleration[:3] > 0.1**2) & (found.acceleration[:3] < 0.5**2))


@pytest.mark.usefixtures("x64")
def test_a_log_that_keeps_less_than_half_is_refused_with_its_reasons(flown):
    config, log = flown
    log = {name: rows.copy() for name, rows in log.items()}
    log["raw_thrust"][200:1000] = np.nan
    with pytest.raises(Refused, match=r"keeps \d+ of \d+ samples in flight; .* by rows lost"):
        identified(config, log)


def test_the_ground_is_found_from_thrust_and_acceleration():
    """A robot stands until nothing but its thrusts carries it; of one that never flies nothing is known."""
    load = np.r_[np.full(30, 0.9), np.linspace(0.9, 0.0, 10), np.full(60, 0.01)]
    found = samples.grounded(load, np.zeros(100))
    assert found[:38].all()
    assert not found[40:].any()
    assert not samples.grounded(np.full(100, 0.9), np.zeros(100)).any()
    assert not samples.grounded(load, np.full(100, 2.0)).any()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda log: log.pop("joint_torque"), "has no `joint_torque`"),
        (lambda log: log.update(time=1e-3 * log["time"]), "expected at least 3 s"),
        (put("raw_thrust", slice(None), np.nan), "has no `raw_thrust`"),
    ],
)
def test_a_log_that_does_not_suffice_is_refused(flown, change, expected):
    with pytest.raises(Refused, match=expected.replace("(", r"\(").replace(")", r"\)").replace("?", r"\?")):
        left_out(flown, change)
