"""Numbers of robots whose truth is hidden, found in one log each.

`jax-aero study hidden_truth` draws robots from `perturbation/unknown_robot.toml`: the controller flies by the file, the
robot differs. Each flies a manoeuvre of 60 s in turbulence, with the sensors of `simulator/robot.toml`. `identify` is
given the log, the file and the robot's mass, as if weighed. Errors are medians over robots and entries, before and
after; `covered` is the share of the 90 % intervals that hold the truth, of all numbers and of those that were found.
Then every robot flies TEST2 for 16 s, with the file and with what was found: masses and axes in the controller, sensors
and thrusts calibrated, latencies and the friction of the drives known.

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

from experiments.identify import command, excite, result, samples
from experiments.study import Findings, Study, find
from experiments.sweep.perturbation import Perturbation
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import exp_so3
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


class Truths(tables.Table, frozen=True):
    """Robots to draw."""

    robots: tables.Count = 10
    """Number of robots."""
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
            rows.append(row_of(config, flown, widths, settings.seed, repeat, nominal))
            print(f"{repeat + 1} of {settings.robots}", flush=True)
    data = xr.Dataset({key: (("robot", f"of_{key}"), np.array([row[key] for row in rows])) for key in rows[0]})
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
) -> dict[str, list[float]]:
    """Return errors, coverage and flights of one robot."""
    robot = rust.Robot(config["robot"])
    drawn, test = copy.deepcopy(flown), rust.set_keys(config, TEST)
    for one in (drawn, test):
        widths.apply(one, seed, repeat, robot)
    flight = rust.fly(drawn)
    log, true = dict(flight.log), load_robot(config["robot"])
    model = robot_of(true, drawn["disturbances"]["model_error"])
    prior = command.prior_of(true, widths)
    _, found, _ = command.identify_robot(config, Path(config["robot"]), [log], prior, float(np.sum(true.masses)), model)
    value, deviation = (command.numbers_of(true, part) for part in (found.value, found.deviation))
    share = command.numbers_of(true, found.share)
    truth = truth_of(true, model, drawn)
    late = {key: samples.latencies(log)[key][0] - nominal[key][0] for key in DELAYS}
    row = errors_of(true, model, value, truth, np.mean(log["raw_thrust"], axis=0))
    for key, name in DELAYS.items():
        delay = drawn["simulator"]["actuation"][name] - flown["simulator"]["actuation"][name]
        row |= {
            f"latency {key} after [ms]": [1e3 * abs(late[key] - delay)],
            f"latency {key} before [ms]": [1e3 * abs(delay)],
        }
    for name, wanted in truth._asdict().items():
        if name in COVERED:
            is_in = np.abs(np.ravel(getattr(value, name)) - np.ravel(wanted)) < command.INTERVAL * np.ravel(
                getattr(deviation, name)
            )
            row |= {
                f"covered {name}": is_in.astype(float).tolist(),
                f"share {name}": np.ravel(getattr(share, name)).tolist(),
            }
    after = calibrated(test, true, model, value, late)
    for label, one in (("before", test), ("after", after)):
        end = rust.fly(one)
        row[f"lost {label}"] = [float(end.outcome != "completed")]
        row[f"lean {label} [deg]"] = [float(np.degrees(end.summary["max_rotation_error"]))]
        row[f"position {label} [cm]"] = [100.0 * float(end.summary["max_com_error"])]
    return row | {"manoeuvre lost": [float(flight.outcome != "completed")]}


COVERED = ("mass", "com", "inertia", "thrust_gain", "thrust_axes", "imu", "encoders", "friction")


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
    """Return medians of errors, coverage of intervals, and counts of lost flights."""
    found = {}
    for key, rows in data.items():
        name, values = str(key), np.asarray(rows)
        if name.startswith("covered"):
            known = np.asarray(data[name.replace("covered", "share")]) >= 0.5
            found[f"{name}, all [%]"] = 100.0 * float(values.mean())
            if known.any():
                found[f"{name}, found [%]"] = 100.0 * float(values[known].mean())
        elif "lost" in name:
            found[name] = float(values.sum())
        else:
            found[name] = float(np.median(values))
    return found
