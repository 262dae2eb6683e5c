"""The robot whose logs these are, whether its numbers explain them, and what would."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.aero import aero_model
from jax_aero.base.terminal import Refused
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.identify import excite, motion, samples, search, verdict
from jax_aero.identify.motion import Model, Numbers, Samples
from jax_aero.identify.numbers import FOUND, labels
from jax_aero.identify.prior import numbers_of
from jax_aero.identify.search import Found
from jax_aero.identify.verdict import Verdict

Array = NDArray[np.float64]
Signals = Mapping[str, Array]

HELD_OUT = 1.0 / 3.0
"""Share of every log, at its end, that is predicted before it is used."""
SCALE_ERROR = 1e-3
"""Standard deviation of a weighing, relative."""


def mistake(
    known: Identified, config: rust.Config, source: Path, signals: Sequence[Signals], prior: Numbers, mass: float | None
) -> str | None:
    """Return the usual mistake without which the first log is explained, if there is one."""
    robot, model = rust.Robot(source), known.robot
    zero = numbers_of(model, np.zeros(known.found.value.size))
    guesses = (zero, numbers_of(model, known.found.value))
    scores = []
    for text, without in verdict.mistakes(signals[0], robot):
        changed = without(signals[0])
        log, _ = samples.sample(changed, config, robot)
        some = Samples(*(part[:: max(len(part) // verdict.SOME, 1)][: verdict.SOME] for part in log))
        scores.append((min(verdict.score(known.model, guess, some) for guess in guesses), text, changed))
    for _, text, changed in sorted(scores, key=lambda one: one[0])[: verdict.TRIED]:
        if identify_robot(config, source, [changed], prior, mass).verdict.is_explained:
            return text
    weight = motion.scale_of(model)[0]
    carried = prior._replace(wrench=np.maximum(prior.wrench, weight * np.eye(6)[2]))
    again = identify_robot(config, source, signals[:1], carried, mass)
    load = float(numbers_of(model, again.found.value).wrench[2])
    if load < verdict.LOAD * weight or again.verdict.unexplained:
        return None
    return f"a load of {load:.0f} N on the feet, or a rope"


def proposals(config: rust.Config, known: Identified) -> list[tuple[str, str, str]]:
    """Return what a log of each manoeuvre of one axis would add, the best first; each is flown in the experiment."""
    robot, estimate = known.robot, known.found
    rows, names = [], [name for name, *_ in labels(robot)]
    numbers = numbers_of(robot, estimate.value)
    with tempfile.TemporaryDirectory() as folder:
        for axis in excite.AXES:
            log = rust.fly(excite.flight(config, [axis], Path(folder))).log
            more, _ = samples.sample(log, config, rust.Robot(config["robot"]))
            left = search.expected(known.model, numbers, estimate, more, samples.PERIOD)
            asked = estimate.prior > 0.0
            remains = float(np.exp(np.mean(np.log(left[asked] / estimate.deviation[asked]))))
            newly = asked & (estimate.share < FOUND) & (left < np.sqrt(0.5) * estimate.prior)
            rows.append((remains, axis, ", ".join(names[place] for place in np.flatnonzero(newly)) or "none"))
    table = [(f"--excite {axis}", f"{100.0 * remains:.0f} %", newly) for remains, axis, newly in sorted(rows)]
    return [("a log of", "intervals left, geometric mean", "found besides"), *table]


def identify_robot(
    config: rust.Config,
    source: Path,
    signals: Sequence[Signals],
    prior: Numbers,
    mass: float | None,
    robot: RobotModel | None = None,
    *,
    is_predicted: bool = False,
) -> Identified:
    """Return the robot whose logs these are, by differences from the file's, and whether they are explained.

    `robot` is another model to start from than that of the file. `is_predicted` holds the last log out, in place of the
    last third of each.
    """
    controller = scenario_config({**config, "robot": str(source), "disturbances": {}}).controller
    robot = load_robot(source) if robot is None else robot
    robot = replace(robot, rotor_inertia=jnp.asarray(controller.torque.rotor_inertia * robot.joint_turns))
    file = rust.Robot(source)
    model = Model(robot, aero_model(controller.aero, robot), np.nanmean(signals[0]["raw_joint_position"], axis=0))
    zero = Numbers(*(np.zeros(np.shape(part)) for part in prior))
    stands = not config["controller"].get("use_jets", True)
    every, again = [], []
    left_out: dict[str, int] = {}
    for log in signals:
        one, reasons = samples.sample(log, config, file, stands)
        if not stands and not reasons.get("feet loaded"):
            load = motion.unexplained(model, zero, one)[:, 2] / motion.scale_of(robot)[0]
            ground = samples.grounded(load, np.linalg.norm(one.linear_velocity, axis=1)) & (one.weight > 0.0)
            one = one._replace(weight=one.weight * ~ground)
            reasons |= {"feet loaded": int(ground.sum())} if ground.any() else {}
        counts = ", ".join(f"{count} by {reason}" for reason, count in reasons.items())
        if one.weight.sum() * samples.PERIOD < samples.LEAST:
            has = f"{one.weight.sum() * samples.PERIOD:g} s of flight beside {samples.SETTLING:g} s at either end"
            of_them = f"; left out: {counts}" if counts else ""
            raise Refused(f"a log has {has}; expected {samples.LEAST:g} s that the equations of flight cover{of_them}")
        flying = one.weight.size - reasons.get("feet loaded", 0) - reasons.get("engines idle", 0)
        if one.weight.sum() < samples.LEAST_SHARE * flying:
            kept = f"{one.weight.sum():.0f} of {flying} samples in flight"
            raise Refused(f"a log keeps {kept}; expected half of them; left out: {counts}")
        left_out = {name: left_out.get(name, 0) + reasons.get(name, 0) for name in {**left_out, **reasons}}
        every.append(one)
        again.append(samples.sample(samples.with_noise_again(log), config, file, stands)[0])
    known = [_part(one.weight, 1.0 if is_predicted else 1.0 - HELD_OUT) for one in every]
    if is_predicted:
        known[-1] = 0
    weighed = None if mass is None else (mass, SCALE_ERROR * mass)
    estimate = search.estimate(model, every, samples.PERIOD, prior, weighed, known=known)
    names = [name for name, *_ in labels(robot)]
    judged = verdict.judge(model, numbers_of(robot, estimate.value), estimate, every, again, known, names)
    return Identified(model, every, estimate, judged, left_out, known)


class Identified(NamedTuple):
    """What was found of a robot.

    Attributes
    ----------
    model
        What the numbers are differences of.
    logs, known
        Samples, and how many of each predict the others.
    left_out
        Samples that the equations do not cover, by reason.
    """

    model: Model
    logs: list[Samples]
    found: Found
    verdict: Verdict
    left_out: dict[str, int]
    known: list[int]

    @property
    def robot(self) -> RobotModel:
        """The robot that the numbers are differences of."""
        return self.model.robot


def _part(weight: Array, share: float) -> int:
    """Return the number of first samples that have a share of all weight."""
    return int(np.searchsorted(np.cumsum(weight), share * np.sum(weight) * (1.0 - 1e-12)) + 1)
