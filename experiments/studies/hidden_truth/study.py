"""Numbers of robots whose truth is hidden, found in one log each.

`jax-aero study hidden_truth` draws robots from `perturbation/unknown_robot.toml`: the controller flies by the file, the
robot differs. Each flies a manoeuvre of 60 s in turbulence, with the sensors of `simulator/robot.toml`. `identify` is
given the log, the file and the robot's mass, as if weighed. Errors are medians over robots and entries, before and
after; `covered` is the share of the 95 % intervals that hold the truth, with what a bootstrap over robots does not
exclude at 1 %, and `width` their geometric mean. Then every robot flies TEST2 for 16 s, with the file and with what
was found: masses and axes in the controller, sensors and thrusts calibrated, latencies and friction known.

The first robots, `defects` of them, fly again with a swinging payload, and with a joint that bends between encoder and
link. No number explains either: such a log should count as not explained, or its intervals be wider.

The result goes to `results/hidden_truth/NAME/`.
"""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import exp_so3
from jax_aero.commands import identify as command
from jax_aero.identify import excite, result, samples
from jax_aero.results.study import Findings, Study, find
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.train import identify
from jax_aero.train.identify import Numbers

Array = NDArray[np.float64]

WIND = {
    "profile": "turbulent", "velocity": [0.0, -5.0, 0.0], "std": [1.0, 1.0, 0.5], "time_scale": 2.0,
    "ramp_start": -2.0, "ramp_end": -1.0,
}  # fmt: skip
"""Wind of the manoeuvre [m/s, s]."""
TEST = {"simulator.duration": 16.0}
"""The flight with the file and with what was found."""
DELAYS = {"torque": "torque_delay", "thrust": "thrust_delay"}
KINDS = {
    "masses": ("mass",),
    "centre of mass": ("com",),
    "inertia": ("inertia",),
    "engines": ("thrust_gain", "thrust_axes"),
    "sensors": ("imu", "encoders"),
    "drives": ("friction",),
    "latency": ("latency",),
}
"""Numbers whose intervals are counted together."""
MONITOR = 4e-4
"""Deviation of the monitor's latency of thrusts from the truth [s]; ours, of other draws."""
PAYLOAD = {"mass": 1.5, "length": 0.6, "angle": 0.35}
"""A mass on a rope at the base that swings by itself [kg, m, rad]."""
BEND = 0.05
"""Standard deviation of the bend of a joint that its encoder does not measure [rad]."""
WIDER = 1.2
"""Geometric mean of intervals, over those of the same robot without a defect, from which they are wider."""


class Truths(tables.Table, frozen=True):
    """Robots to draw."""

    robots: tables.Count = 10
    """Number of robots."""
    defects: tables.Count = 2
    """Number of robots that fly again with each defect."""
    seed: tables.Seed = 1
    """Seed of the draws."""


def compute(_: str, settings: Truths) -> Findings:
    """Draw, fly, identify, and fly again."""
    widths = tables.load(find("perturbation", "unknown_robot"), Perturbation)
    config = rust.load_config("robot")
    rows = []
    with jax.enable_x64(True), tempfile.TemporaryDirectory() as folder:
        flown = excite.flight({**config, "wind": WIND}, tuple(excite.AXES), Path(folder))
        nominal = samples.latencies(rust.fly(flown).log)
        for repeat in range(settings.robots):
            has_defects = repeat < settings.defects
            rows.append(row_of(config, flown, widths, settings.seed, repeat, nominal, has_defects))
            print(f"{repeat + 1} of {settings.robots}", flush=True)
    data = xr.Dataset(
        {
            key: (("robot", f"of_{key}"), np.array([row.get(key, np.full(len(rows[0][key]), np.nan)) for row in rows]))
            for key in rows[0]
        }
    )
    return Findings(
        "Numbers of robots from one log each, truth hidden", data, summary_of(data), flights={"robot": config}
    )


STUDY = Study("hidden_truth", __doc__, Truths, compute, ("ten",), backend="rust and jax")
main = STUDY.main


def row_of(
    config: rust.Config,
    flown: rust.Config,
    widths: Perturbation,
    seed: int,
    repeat: int,
    nominal: Mapping[str, tuple[float, float]],
    has_defects: bool,
) -> dict[str, list[float]]:
    """Return errors, coverage and flights of one robot."""
    robot = rust.Robot(config["robot"])
    drawn, test = copy.deepcopy(flown), rust.set_keys(config, TEST)
    for one in (drawn, test):
        widths.apply(one, seed, repeat, robot)
    flight = rust.fly(drawn)
    log, true = dict(flight.log), load_robot(config["robot"])
    model = robot_of(true, drawn["disturbances"]["model_error"])
    rng, mass = np.random.default_rng([seed, repeat]), float(np.sum(true.masses))
    mass *= 1.0 + command.SCALE_ERROR * rng.normal()
    prior = command.prior_of(true, widths)

    def identified(log: Mapping[str, Array]) -> command.Identified:
        return command.identify_robot(config, Path(config["robot"]), [log], prior, mass, model)

    known = identified(log)
    found = known.found
    value = command.numbers_of(true, found.value)
    low, high = (command.numbers_of(true, part) for part in command.intervals(true, found))
    truth = truth_of(true, model, drawn)
    late = {key: samples.latencies(log)[key][0] - nominal[key][0] for key in DELAYS}
    row = errors_of(true, model, value, truth, np.mean(log["raw_thrust"], axis=0))
    of_drawn, of_file = (one["simulator"]["actuation"] for one in (drawn, flown))
    delays = {key: of_drawn[name] - of_file[name] for key, name in DELAYS.items()}
    for key, delay in delays.items():
        row |= {
            f"latency {key} after [ms]": [1e3 * abs(late[key] - delay)],
            f"latency {key} before [ms]": [1e3 * abs(delay)],
        }
    ends = {name: (getattr(low, name), getattr(high, name), getattr(truth, name)) for name in truth._fields}
    # The delay of torques is beside the controller's latency, which has the drives' lag, but no jitter.
    half = command.Z * MONITOR
    ends["latency"] = (
        np.array([low.delay[1], late["thrust"] - half]),
        np.array([high.delay[1], late["thrust"] + half]),
        np.array([delays["torque"] + 0.5 * of_drawn["jitter"], delays["thrust"]]),
    )
    for kind, names in KINDS.items():
        least, most, wanted = (np.concatenate([np.ravel(ends[name][part]) for name in names]) for part in range(3))
        row[f"covered {kind}"] = ((least <= wanted) & (wanted <= most)).astype(float).tolist()
        row[f"width {kind}"] = (most - least).tolist()
    row |= {"explained": [float(known.verdict.is_explained)]}
    after = calibrated(test, true, model, value, late)
    for label, one in (("before", test), ("after", after)):
        end = rust.fly(one)
        row[f"lost {label}"] = [float(end.outcome != "completed")]
        row[f"lean {label} [deg]"] = [float(np.degrees(end.summary["max_rotation_error"]))]
        row[f"position {label} [cm]"] = [100.0 * float(end.summary["max_com_error"])]
    for name in ("payload", "flexible joint"):
        row[f"{name} detected"] = [np.nan]
        if has_defects:
            other = identified(with_payload(drawn, robot, rng) if name == "payload" else bent(log, rng))
            free = found.prior > 0.0
            wider = np.exp(np.mean(np.log(other.found.deviation[free] / found.deviation[free])))
            row[f"{name} detected"] = [float(not other.verdict.is_explained or wider > WIDER)]
    return row | {"manoeuvre lost": [float(flight.outcome != "completed")]}


def with_payload(drawn: rust.Config, robot: rust.Robot, rng: np.random.Generator) -> dict[str, Array]:
    """Return the log of a flight in which a payload swings under the base in a drawn direction."""
    flown, (mass, length, angle), step = copy.deepcopy(drawn), PAYLOAD.values(), 0.05
    rate, phase, side = np.sqrt(robot.gravity / length), rng.uniform(0.0, 6.0), rng.uniform(0.0, 6.0)
    pushes = flown["disturbances"].setdefault("pushes", [])
    for start in np.arange(0.0, flown["simulator"]["duration"], step):
        swing = angle * np.sin(rate * start + phase)
        pull = mass * (robot.gravity * np.cos(swing) + length * (angle * rate * np.cos(rate * start + phase)) ** 2)
        force = pull * np.array([np.sin(swing) * np.cos(side), np.sin(swing) * np.sin(side), -np.cos(swing)])
        pushes.append({"body": robot.body_names[0], "force": force.tolist(), "start": float(start), "duration": step})
    return dict(rust.fly(flown).log)


def bent(log: Mapping[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """Return a log in which one of the joints that work most bends with its torque between encoder and link."""
    torque, positions = log["joint_torque"], log["raw_joint_position"].copy()
    size = np.std(torque, axis=0)
    joint = rng.choice(np.argsort(-size)[:6])
    positions[:, joint] += BEND * torque[:, joint] / size[joint]
    return {**log, "raw_joint_position": positions}


def robot_of(robot: RobotModel, error: Mapping[str, Any]) -> RobotModel:
    """Return the robot that the controller models."""
    turns, axes = jnp.asarray(error["thrust_axes"]), jnp.asarray(robot.jets.axes)
    return replace(
        robot,
        masses=error["mass_scale"] * robot.masses,
        inertias=error["mass_scale"] * error["inertia_scale"] * robot.inertias,
        coms=np.asarray(robot.coms) + np.eye(len(robot.masses), 1) * np.array(error["com_offset"]),
        jets=replace(robot.jets, axes=jnp.einsum("jab,jb->ja", exp_so3(turns), axes)),
    )


def truth_of(robot: RobotModel, model: RobotModel, drawn: rust.Config) -> Numbers:
    """Return the numbers that make of the modelled robot the one that flew."""
    error, simulator = drawn["disturbances"]["model_error"], drawn["simulator"]
    sensors, scales = simulator["sensors"], drawn["disturbances"]["jets"]["force_scale"]
    sides = jax.vmap(identify.across)(jnp.asarray(model.jets.axes))
    tilts = jnp.einsum("jab,ja->jb", sides, jnp.cross(model.jets.axes, jnp.asarray(robot.jets.axes)))
    prior = command.prior_of(robot, Perturbation())
    nothing = Numbers(*(np.zeros(np.shape(part)) for part in prior))
    return nothing._replace(
        mass=np.array(1.0 / error["mass_scale"] - 1.0),
        com=-np.array(error["com_offset"]),
        inertia=np.array(1.0 / error["inertia_scale"] - 1.0),
        thrust_gain=np.array([scales[name] - 1.0 for name in robot.jets.names]),
        thrust_offset=np.full(robot.jets.count, sensors["thrust"]["bias"]),
        thrust_axes=np.asarray(tilts),
        imu=np.array(sensors["base_rotation"]["bias"]),
        encoders=np.array(sensors["joints"]["bias"]),
        friction=np.array([simulator["motors"]["friction_of"][name] for name in robot.joint_names]),
    )


def errors_of(
    robot: RobotModel, model: RobotModel, value: Numbers, truth: Numbers, thrust: Array
) -> dict[str, list[float]]:
    """Return errors before and after; of a jet's force at the mean thrust of the log, of the axis as an angle."""

    def force(numbers: Numbers) -> Array:
        acting: Array = np.asarray((1.0 + numbers.thrust_gain) * (thrust - numbers.thrust_offset))
        return acting

    def angle(axes: Any) -> Array:
        apart: Array = np.degrees(np.linalg.norm(np.cross(axes, robot.jets.axes), axis=1))
        return apart

    zero = Numbers(*(np.zeros_like(part) for part in truth))
    share = 1e3 * float(robot.masses[0] / np.sum(robot.masses))
    found = {}
    for label, guess in (("before", zero), ("after", value)):
        axes = identify.robot_with(model, guess).jets.axes
        degrees = {
            name: np.degrees(np.asarray(getattr(guess, name) - getattr(truth, name))) for name in ("imu", "encoders")
        }
        for key, error in {
            f"mass {label} [%]": 100.0 * (guess.mass - truth.mass),
            f"centre of mass of the robot {label} [mm]": share * (guess.com - truth.com),
            f"inertia {label} [%]": 100.0 * (guess.inertia - truth.inertia),
            f"thrust gain {label} [%]": 100.0 * (force(guess) / force(truth) - 1.0),
            f"thrust axes {label} [deg]": angle(axes),
            f"imu {label} [deg]": degrees["imu"],
            f"encoders {label} [deg]": degrees["encoders"],
            f"friction {label} [N m]": guess.friction - truth.friction,
        }.items():
            found[key] = np.abs(np.atleast_1d(error)).tolist()
    return found


def calibrated(
    test: rust.Config, robot: RobotModel, model: RobotModel, value: Numbers, late: Mapping[str, float]
) -> rust.Config:
    """Return a flight whose controller knows what was found: its robot, its sensors and thrusts, its latencies."""
    after = copy.deepcopy(test)
    error, sensors = after["disturbances"]["model_error"], after["simulator"]["sensors"]
    axes = np.asarray(identify.robot_with(model, value).jets.axes)
    error["mass_scale"] *= float(1.0 + value.mass)
    error["inertia_scale"] *= float(1.0 + value.inertia)
    error["com_offset"] = np.add(error["com_offset"], value.com).tolist()
    error["thrust_axes"] = np.cross(robot.jets.axes, axes).tolist()
    scale = after["disturbances"]["jets"]["force_scale"]
    for name, gain in zip(robot.jets.names, np.asarray(value.thrust_gain), strict=True):
        scale[name] /= float(1.0 + gain)
    sensors["thrust"]["bias"] -= float(np.mean(value.thrust_offset))
    for name, part in (("base_rotation", value.imu), ("joints", value.encoders)):
        sensors[name]["bias"] = np.subtract(sensors[name]["bias"], part).tolist()
    latency = after["controller"]["estimator"]["latency"]
    for key in DELAYS:
        latency[key] = max(latency[key] + late[key], 0.0)
    after["controller"]["torque"]["friction"] = result.frictions(robot, value.friction)
    return after


def summary_of(data: xr.Dataset) -> dict[str, float]:
    """Return medians of errors, coverage of intervals, and counts of robots."""
    found = {}
    for key, rows in data.items():
        name, values = str(key), np.asarray(rows)
        if name.startswith("covered"):
            found[f"{name} [%]"] = 100.0 * float(values.mean())
            low, high = not_excluded(values)
            found[f"{name}, at least [%]"], found[f"{name}, at most [%]"] = 100.0 * low, 100.0 * high
        elif name.startswith("width"):
            found[name] = float(np.exp(np.mean(np.log(values))))
        elif any(word in name for word in ("lost", "explained", "detected")):
            found[name] = float(np.nansum(values))
        else:
            found[name] = float(np.median(values))
    return found


def not_excluded(covered: Array) -> tuple[float, float]:
    """Return the interval of a coverage that a bootstrap over robots does not exclude at 1 %.

    Where every interval holds the truth, so that no bootstrap varies, that of independent intervals.
    """
    if covered.all():
        return 0.005 ** (1.0 / covered.size), 1.0
    drawn = np.random.default_rng(0).choice(covered.mean(axis=1), (10000, len(covered))).mean(axis=1)
    low, high = np.quantile(drawn, [0.005, 0.995])
    return float(low), float(high)
