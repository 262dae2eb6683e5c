"""Numbers of robots whose truth is hidden, found in one log each.

`jax-aero study hidden_truth` draws robots (`draw.py`): the controller flies by the file, the robot differs. `identify`
is given the log, the file and the robot's mass, as if weighed. Only numbers that are found count, of logs that are
explained. `covered` is the share of their 95 % intervals that hold the truth, with the ends of what a bootstrap over
robots leaves of 95 %; `width` is the median width in still air; errors are medians, of the file and of what was found.

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

from experiments.studies.hidden_truth import draw
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.terminal import Refused
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import exp_so3
from jax_aero.identify import motion
from jax_aero.identify.identified import Identified, identify_robot
from jax_aero.identify.motion import Numbers
from jax_aero.identify.numbers import FOUND, estimates, labels
from jax_aero.identify.prior import prior_of
from jax_aero.results.study import Findings, Study
from jax_aero.results.work import Work

Array = NDArray[np.float64]

KINDS = {
    "mass and inertia": ("mass", "inertia"),
    "centre of mass": ("com",),
    "thrust gains": ("thrust_gain",),
    "tilts": ("thrust_axes",),
    "base's sensor": ("imu",),
    "encoders": ("encoders",),
    "drives": ("friction", "torque_gain"),
    "latencies": ("delay",),
}
"""Numbers whose intervals are counted together."""
PAYLOAD = {"mass": 1.5, "length": 0.6, "angle": 0.35}
"""A mass on a rope at the base that swings by itself [kg, m, rad]."""
BEND = 0.05
"""Standard deviation of the bend of a joint that its encoder does not measure [rad]."""
WIDER = 1.2
"""Geometric mean of intervals, over those of the same robot without a defect, from which they are wider."""
DRAWS = 10_000
"""Of the bootstrap."""


class Truths(tables.Table, frozen=True):
    """Robots to draw."""

    robots: tables.Count = 72
    """Number of robots."""
    defects: tables.Natural = 2
    """Number of robots that fly again with each defect."""
    seed: tables.Seed = 1
    """Seed of the draws."""


def compute(_: str, settings: Truths, work: Work) -> Findings:
    """Draw, fly and identify."""
    rows = []
    for number in range(settings.robots):
        job = f"robot {number}"
        if (row := work.read_json(job)) is None:
            with jax.enable_x64(True), tempfile.TemporaryDirectory() as folder:
                row = row_of(settings.seed, number, number < settings.defects, Path(folder))
            work.write_json(job, row)
        rows.append(row)
        print(f"{number + 1} of {settings.robots}", flush=True)
    cases = [draw.case_of(number) for number in range(settings.robots)]
    of_robots = {key: ("robot", [row[key] for row in rows]) for key in ("outcome", "verdict", "is_explained", *DEFECTS)}
    data = xr.Dataset(
        {key: (("robot", "number"), np.array([row[key] for row in rows], dtype=float)) for key in NUMBERS} | of_robots,
        {
            "number": rows[0]["names"],
            **{key: ("robot", [getattr(case, key) for case in cases]) for key in draw.Case._fields},
        },
    )
    flights = {"robot": rust.load_config(draw.EXPERIMENT)}
    return Findings("Numbers of robots from one log each, truth hidden", data, summary_of(data), flights=flights)


NUMBERS = ("truth", "low", "high", "value", "share")
DEFECTS = ("payload detected", "flexible joint detected")
STUDY = Study("hidden_truth", __doc__, Truths, compute, ("seventy_two",), backend="rust and jax", resumes=True)
main = STUDY.main


def row_of(seed: int, number: int, has_defects: bool, folder: Path) -> dict[str, Any]:
    """Return what was found of one robot, beside its truth."""
    config = draw.flight_of(draw.case_of(number), folder)
    drawn, gains = draw.draw(config, seed, number, folder)
    flight = rust.fly(drawn)
    log = dict(flight.log) | {"joint_torque": flight.log["joint_torque"] * gains}
    file, actual = load_robot(config["robot"]), load_robot(drawn["robot"])
    model = robot_of(file, drawn["disturbances"]["model_error"])
    rng = np.random.default_rng([seed, number])
    mass = float(np.sum(actual.masses)) * (1.0 + draw.WEIGHING * rng.normal())
    prior = prior_of(file, draw.WIDTHS)

    def identified(log: Mapping[str, Array]) -> Identified:
        return identify_robot(config, Path(config["robot"]), [log], prior, mass, model)

    truth = truth_of(file, actual, model, drawn, gains, np.mean(log["raw_joint_position"], axis=0))
    every = np.concatenate([np.ravel(part) for part in truth])
    is_known = np.isfinite(every)
    names = np.array([name for name, *_ in labels(file)])[is_known].tolist()
    row: dict[str, Any] = {"names": names, "outcome": flight.outcome, "is_explained": False}
    row |= {key: [None] * len(names) for key in NUMBERS} | dict.fromkeys(DEFECTS, -1)
    row["truth"] = every[is_known].tolist()
    try:
        known = identified(log)
    except Refused as reason:
        return row | {"verdict": str(reason)}
    estimate = known.found
    low, middle, high = (part[is_known].tolist() for part in estimates(file, estimate))
    row |= {"low": low, "high": high, "value": middle, "share": estimate.share[is_known].tolist()}
    against = [*(one.name for one in known.verdict.unexplained), *known.verdict.conflicts]
    row |= {"is_explained": known.verdict.is_explained, "verdict": ", ".join(against)}
    for name in DEFECTS if has_defects else ():
        changed = with_payload(drawn, gains, rng) if name == DEFECTS[0] else bent(log, rng)
        other = identified(changed)
        free = estimate.prior > 0.0
        wider = np.exp(np.mean(np.log(other.found.deviation[free] / estimate.deviation[free])))
        row[name] = int(not other.verdict.is_explained or wider > WIDER)
    return row


def with_payload(drawn: rust.Config, gains: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return the log of a flight in which a payload swings under the base in a drawn direction."""
    flown, (mass, length, angle), step = copy.deepcopy(drawn), PAYLOAD.values(), 0.05
    robot = rust.Robot(drawn["robot"])
    rate, phase, side = np.sqrt(robot.gravity / length), rng.uniform(0.0, 6.0), rng.uniform(0.0, 6.0)
    pushes = flown["disturbances"].setdefault("pushes", [])
    for start in np.arange(0.0, flown["simulator"]["duration"], step):
        swing = angle * np.sin(rate * start + phase)
        pull = mass * (robot.gravity * np.cos(swing) + length * (angle * rate * np.cos(rate * start + phase)) ** 2)
        force = pull * np.array([np.sin(swing) * np.cos(side), np.sin(swing) * np.sin(side), -np.cos(swing)])
        pushes.append({"body": robot.body_names[0], "force": force.tolist(), "start": float(start), "duration": step})
    log = dict(rust.fly(flown).log)
    return log | {"joint_torque": log["joint_torque"] * gains}


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


def truth_of(
    file: RobotModel, actual: RobotModel, model: RobotModel, drawn: rust.Config, gains: Array, posture: Array
) -> Numbers:
    """Return the numbers that make of the modelled robot the one that flew; NaN where they say nothing of it."""
    simulator, scales = drawn["simulator"], drawn["disturbances"]["jets"]["force_scale"]
    sensors, late = simulator["sensors"], simulator["actuation"]
    sides = jax.vmap(motion.across)(jnp.asarray(model.jets.axes))
    tilts = jnp.einsum("jab,ja->jb", sides, jnp.cross(model.jets.axes, jnp.asarray(file.jets.axes)))
    prior = prior_of(file, draw.WIDTHS)
    unknown = Numbers(*(np.full(np.shape(part), np.nan) for part in prior))
    mass, com, inertia = whole(model, actual, posture)
    before = rust.load_config(draw.EXPERIMENT)["simulator"]["actuation"]["torque_delay"]
    return unknown._replace(
        mass=mass,
        com=com,
        inertia=inertia,
        thrust_gain=np.array([scales[name] - 1.0 for name in file.jets.names]),
        thrust_axes=np.asarray(tilts),
        torque_gain=np.array([1.0 / gains[joints[0]] - 1.0 for _, joints in file.joint_groups]),
        imu=np.array(sensors["base_rotation"]["bias"]),
        encoders=np.array(sensors["joints"]["bias"]),
        friction=np.array([simulator["motors"]["friction_of"][name] for name in file.joint_names]),
        # That of torques is beside the controller's latency, which has the drives' lag, but no jitter.
        delay=np.array([np.nan, late["torque_delay"] - before + 0.5 * late["jitter"]]),
    )


def whole(model: RobotModel, actual: RobotModel, posture: Array) -> tuple[Array, Array, Array]:
    """Return mass, centre of mass and inertia as `Numbers` has them, of a robot whose bodies may all differ."""
    kin = kinematics_at_rest(model, jnp.asarray(posture))
    rotations, positions = np.asarray(kin.body_rotations), np.asarray(kin.body_positions)
    of_model, of_actual = (
        tuple(map(np.asarray, (robot.masses, robot.coms, robot.inertias))) for robot in (model, actual)
    )

    def places(coms: Array) -> Array:
        placed: Array = positions + np.einsum("bij,bj->bi", rotations, coms)
        return placed

    def spread(masses: Array, coms: Array) -> float:
        return float(masses @ np.sum((places(coms) - masses @ places(coms) / masses.sum()) ** 2, axis=1))

    (m_0, c_0, i_0), (m, c, i) = of_model, of_actual
    scale = m.sum() / m_0.sum()
    com = (m @ places(c) / scale - m_0 @ places(c_0)) / m_0[0]
    moved = c_0 + np.eye(len(m), 1) * com
    own, own_0 = (float(np.trace(rows, axis1=1, axis2=2).sum()) for rows in (i, i_0))
    inertia = ((own + 2.0 * spread(m, c)) / scale - 2.0 * spread(m_0, moved)) / own_0 - 1.0
    return np.array(scale - 1.0), com, np.array(inertia)


def summary_of(data: xr.Dataset) -> dict[str, float]:
    """Return coverage, widths and errors by kind, and counts of robots."""
    names = np.array([str(name).split(".")[0] for name in data["number"].values])
    truth, low, high, value, share = (np.asarray(data[key]) for key in NUMBERS)
    is_explained = np.asarray(data["is_explained"], dtype=bool)
    is_still = np.asarray(data["wind"]) == next(iter(draw.WINDS))
    is_found = (share >= FOUND) & is_explained[:, None]
    summary: dict[str, float] = {}
    for kind, parts in KINDS.items():
        of = np.isin(names, parts)
        counted, holds = is_found[:, of], (low <= truth)[:, of] & (truth <= high)[:, of]
        summary[f"found {kind}"] = float(counted.sum())
        if not counted.any():
            continue
        summary[f"covered {kind} [%]"] = 100.0 * float(holds[counted].mean())
        least, most = bootstrapped(counted, holds)
        summary |= {f"covered {kind}, at least [%]": 100.0 * least, f"covered {kind}, at most [%]": 100.0 * most}
        summary[f"width {kind}"] = float(np.median((high - low)[is_still][:, of][counted[is_still]]))
        summary[f"error {kind} before"] = float(np.median(np.abs(truth[:, of][counted])))
        summary[f"error {kind} after"] = float(np.median(np.abs(value - truth)[:, of][counted]))
    for key in ("is_outside", "mission", "wind"):
        for group in np.unique(data[key]):
            counted = is_found & np.asarray(data[key] == group)[:, None] & np.isin(names, sum(KINDS.values(), ()))
            label = {"True": "outside", "False": "inside"}.get(str(group), str(group))
            summary[f"covered, {label} [%]"] = 100.0 * float(((low <= truth) & (truth <= high))[counted].mean())
    summary["explained"] = float(is_explained.sum())
    summary["completed"] = float(np.sum(data["outcome"] == "completed"))
    return summary | {name: float(np.sum(data[name] == 1)) for name in DEFECTS if np.any(data[name] >= 0)}


def bootstrapped(counted: NDArray[np.bool_], holds: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the ends of what a bootstrap over robots leaves of 95 % of a coverage.

    Where every interval holds the truth, so that no bootstrap varies, those of independent intervals.
    """
    of, all_of = (counted & holds).sum(axis=1), counted.sum(axis=1)
    if of.sum() == all_of.sum():
        return float(0.025 ** (1.0 / all_of.sum())), 1.0
    drawn = np.random.default_rng(0).integers(len(of), size=(DRAWS, len(of)))
    low, high = np.quantile(of[drawn].sum(axis=1) / np.maximum(all_of[drawn].sum(axis=1), 1), [0.025, 0.975])
    return float(low), float(high)
