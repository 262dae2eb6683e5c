"""Find a robot's numbers in its own logs, and write the robot that they make.

LOG is what `jax-aero replay` reads: a result of `jax-aero fly`, an MCAP, MATLAB or CSV file. Samples that the equations
do not cover are left out: on the ground, with idle engines or saturated commands, about lost rows and jumps. The last
third of each log is predicted by the numbers of the others before it is used. Where it is not, no number is shown, no
robot is written without --anyway, and the status is 1; mistakes that would explain the log are named.

Every number has its 95 % interval and the share of the data in it; below half it is not found.
`results/identify/NAME/` holds `numbers.json`, `held_out.png`, `robot.toml`, which builds on the old file,
`experiment.toml`, which flies it in a world with what was found of sensors, drives and engines, and
`perturbation.toml` of what is left unknown. With --excite AXES, in place of LOG, it holds a mission that moves these
axes, `excite.toml`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from jax_aero import rust
from jax_aero.aero import aero_model
from jax_aero.base import arguments, places, plain_values, tables
from jax_aero.base.files import complete_folder
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.kinematics import kinematics_at_rest
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import rotate
from jax_aero.identify import excite, result, samples, verdict
from jax_aero.identify.verdict import Verdict
from jax_aero.results import study
from jax_aero.results.table import text_table
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.train import identify
from jax_aero.train.identify import Found, Model, Numbers, Samples
from jax_aero.view import logs

Array = NDArray[np.float64]
Signals = Mapping[str, Array]
Record = dict[str, Any]

GROUPS = {
    "masses": ("mass", "com", "inertia", "bodies", "fuel"),
    "axes": ("thrust_axes",),
    "engines": ("thrust_gain", "thrust_offset"),
    "sensors": ("imu", "gyro", "encoders"),
    "drives": ("torque_gain", "friction", "damping"),
    "delays": ("delay",),
    "air": ("air", "air_turn", "air_point", "wrench", "wind"),
}
"""Numbers by the word of `--only`."""
UNITS = {
    "mass": ("%", 100.0),
    "com": ("mm", 1e3),
    "inertia": ("%", 100.0),
    "bodies": ("1e-3, mm", 1e3),
    "fuel": ("mg/(N s)", 1e6),
    "torque_gain": ("%", 100.0),
    "thrust_gain": ("%", 100.0),
    "thrust_offset": ("N", 1.0),
    "thrust_axes": ("deg", np.degrees(1.0)),
    "imu": ("deg", np.degrees(1.0)),
    "gyro": ("deg", np.degrees(1.0)),
    "encoders": ("deg", np.degrees(1.0)),
    "friction": ("N m", 1.0),
    "damping": ("N m s", 1.0),
    "air": ("%", 100.0),
    "air_turn": ("deg", np.degrees(1.0)),
    "air_point": ("mm", 1e3),
    "wrench": ("N, N m", 1.0),
    "wind": ("m/s", 1.0),
    "delay": ("ms", 1e3),
}
BODY = ("mass", "x", "y", "z", "size.x", "size.y", "size.z", "shear.zx", "shear.zy", "shear.yx")
"""Parts of a body's numbers."""
FOUND = 0.5
"""Share of the data in a number from which it is found."""
RELATED = 0.3
"""Correlation of errors from which it is stored."""
INTERVAL = 0.95
"""Probability of an interval."""
Z = float(ndtri(0.5 + 0.5 * INTERVAL))
"""Its half width in deviations of a normal distribution."""
MANY = ("bodies", "air_turn", "air_point")
"""Numbers of which only those that are found are shown."""
UNIFORM = ("mass", "com", "inertia", "thrust_gain", "torque_gain", "thrust_axes", "imu", "encoders", "friction")
"""Numbers whose prior is uniform."""
HELD_OUT = 1.0 / 3.0
"""Share of every log, at its end, that is predicted before it is used."""
SCALE_ERROR = 1e-3
"""Standard deviation of a weighing, relative."""
CONSTANT = (2.4e-3, 2.6e-3)
"""Standard deviation of a constant force and moment that no number explains, over the weight and over that at the
radius of gyration: a network's air less its fit."""
OFFSET = 0.01
"""Of a thrust sensor's offset, over the greatest thrust: half of the 2 % of Momin et al., ICRA 2022."""
DAMPING = 0.5
"""Of the drives' viscous friction [N m s]: that of `simulator/robot.toml`."""
DELAY = 0.005
"""Of delays that the controller's estimator does not state [s]: half a period of commands that are held."""
WIND = 5.0
"""Of a wind that is not measured [m/s]."""
TORQUE_GAIN = 1.0 / 0.9 - 1.0
"""Half width of the gain of measured torques, which are within 10 %: harmonic drives, whose efficiency varies with
load."""
BODIES = (0.03, 0.003, 0.02)
"""Half widths of bodies' masses, relative, centres [m] and sizes, relative, beside what the robot has in common: of
CAD, and of cables and screws that it lacks. Ours."""
HEAVY, LOAD = 0.02, (1.0, 0.15)
"""Share of the whole mass from which bodies have these; what the heaviest one may carry, how far from its centre [kg,
m], which is found as mass, centre and inertia of the whole."""
FUEL = 3e-5
"""Deviation of the consumption [kg/(N s)]: that of small turbines is 4e-5 to 5e-5."""
GYRO = np.radians(0.05)
"""Of the gyroscope's rotation in its case [rad]: that of the MTi's data."""
TURNED = (0.3, 0.03)
"""Of the direction of the air's force on a link [rad], and of its point [m]: of a model's, by a network; ours."""


def main(words: Sequence[str]) -> int:
    """Identify, or write a mission; return the exit status."""
    parser = arguments.Parser("identify", __doc__)
    parser.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="result, or .mcap, .mat or .csv file")
    about = "experiment with the controller and the world (default: what the first log was flown with)"
    parser.add_argument("--experiment", metavar="NAME", help=about)
    parser.add_argument("--robot", metavar="FILE", help="robot file to start from (default: that of the experiment)")
    parser.add_argument("--map", type=Path, metavar="FILE", help="TOML file that names the columns of a log of others")
    parser.add_argument("--mass", type=float, metavar="KG", help="mass of the robot on a scale")
    parser.add_argument("--predict", type=Path, metavar="LOG", help="log to be predicted, in place of the last thirds")
    about = f"show and change some of {', '.join(GROUPS)} alone; the others stay uncertain"
    parser.add_argument("--only", default=",".join(GROUPS), metavar="WORDS", help=about)
    parser.add_argument("--still-air", action="store_true", help="take wind that is not measured as none")
    parser.add_argument("--anyway", action="store_true", help="write a robot that does not explain its log")
    about = "perturbation whose half widths are the errors of the robot's file (default unknown_robot)"
    parser.add_argument("--prior", default="unknown_robot", metavar="NAME", help=about)
    parser.add_argument("--propose", action="store_true", help="say how much a log of each axis in motion would add")
    parser.add_argument("--excite", metavar="AXES", help=f"write a mission that moves some of {','.join(excite.AXES)}")
    about = "wind of that mission, of configs/wind (default: still air, in which numbers are found best)"
    parser.add_argument("--wind", metavar="NAME", default="still", help=about)
    arguments.add_name(parser, "that of the first log")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/identify)")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing result")
    given = parser.parse_args(words)
    return exit_status(lambda: _excite(given) if given.excite else _identify(given))


def _identify(given: argparse.Namespace) -> int:
    if not given.logs:
        raise Refused("there is no LOG; expected one, or --excite AXES")
    named = None if given.experiment is None else rust.load_config(given.experiment)
    config = named or logs.read(given.logs[0], None, given.map, given.robot).config
    if config is None:
        raise Refused(f"`{given.logs[0]}` does not hold the configuration of a flight; expected --experiment NAME")
    source = Path(given.robot or config["robot"]).resolve()
    words = given.only.split(",")
    if unknown := [word for word in words if word not in GROUPS]:
        raise Refused(f"--only is `{unknown[0]}`; expected some of {', '.join(GROUPS)}")
    folder = (given.out or places.RESULTS / "identify") / (given.named or given.logs[0].stem)
    if folder.exists() and not given.overwrite:
        raise Refused(f"`{folder}` exists; expected --overwrite, or another --name")
    paths = [*given.logs, *([given.predict] if given.predict else [])]
    signals = [samples.read(path, given.map, config, str(source)) for path in paths]
    widths = tables.load(study.find("perturbation", given.prior), Perturbation)
    _check_mass(given.mass, load_robot(source), widths)
    has_wind = all(map(samples.is_measured, signals))
    with jax.enable_x64(True):
        prior = prior_of(load_robot(source), widths, 0.0 if has_wind or given.still_air else WIND)
        known = identify_robot(config, source, signals, prior, given.mass, is_predicted=given.predict is not None)
        robot, found, judged = known.robot, known.found, known.verdict
        shown = _places(robot, found, words)
        rows = records(robot, found, shown)
        wind = "measured" if has_wind else "taken as none" if given.still_air else "found as constant"
        digest = hashlib.sha256(
            b"".join(np.ascontiguousarray(log[name]).tobytes() for log in signals for name in samples.MEASURED)
        ).hexdigest()
        facts = {
            "sha256": digest,
            "explained": judged.is_explained,
            "wind": wind,
            "samples": sum(int(np.sum(log.weight)) for log in known.logs),
            "left_out": known.left_out,
            "conflicts": judged.conflicts,
            "held_out": [row._asdict() for row in judged.rows],
            "numbers": rows,
            "correlations": correlations(robot, found, shown),
        }
        text = json.dumps(facts, indent=1, ensure_ascii=False) + "\n"
        numbers = numbers_of(robot, np.where(shown, found.value, 0.0))
        is_found = numbers_of(robot, (shown & (found.share >= FOUND)).astype(float))
        notes = [
            f"Found by jax-aero identify in logs with sha256 {digest}.",
            *([] if judged.is_explained else ["The model does not explain the log."]),
            *(f"{row['name']}: {describe(row)}" for row in rows),
        ]
        with complete_folder(folder, replace=given.overwrite) as draft:
            (draft / "numbers.json").write_text(text, encoding="utf-8")
            _draw(known, draft / "held_out.png")
            if judged.is_explained or given.anyway:
                result.write_perturbation(draft, numbers_of(robot, found.deviation))
                result.write_experiment(draft, config, robot, numbers, is_found)
                result.write_robot(draft, source, known.model, numbers, notes)
        for reason, count in known.left_out.items():
            print(f"{count} of {sum(len(log.weight) for log in known.logs)} samples left out: {reason}")
        print(f"wind: {wind}")
        print(text_table(tested(judged)))
        print(f"numbers leave {judged.improvement:.2g} times less of the base's accelerations than the file")
        if not judged.is_explained:
            _print_reasons(known, config, source, signals, prior, given.mass)
            if not given.anyway:
                print(f"{folder / 'numbers.json'}: the log is not explained; no robot is written without --anyway")
                return 1
    few = [row for row in rows if row["found"] or row["name"].split(".")[0] not in MANY]
    table = [(row["name"], describe(row), f"{row['share']:.2f}{'' if row['found'] else ', not found'}") for row in few]
    print(text_table([("difference from the file", "value, 95 % interval", "share of the data"), *table]))
    if config["controller"]["fault_detection"].get("latency"):
        computed = rust.replay({**config, "robot": str(folder / "robot.toml"), "disturbances": {}}, signals[0])
        for key, (median, deviation) in samples.latencies(computed).items():
            print(f"latency of the {key}s by the controller's monitor: {1e3 * median:.1f} ± {1e3 * deviation:.1f} ms")
    names = [name for name, *_ in labels(robot)]
    for share, direction in found.undetermined():
        largest = np.argsort(-np.abs(direction))[:4]
        mix = " ".join(f"{direction[place]:+.2f} {names[place]}" for place in largest if abs(direction[place]) > 0.1)
        print(f"{100.0 * share:.0f} % of the prior's variance is left along {mix}")
    if given.propose:
        with jax.enable_x64(True):
            print(text_table(proposals({**config, "robot": str(source), "disturbances": {}}, known)))
    print(f"fly it: jax-aero fly {folder / 'experiment.toml'}")
    return int(not judged.is_explained)


def _check_mass(mass: float | None, robot: RobotModel, widths: Perturbation) -> None:
    """Refuse a weighing that the file excludes."""
    stated = float(np.sum(robot.masses))
    if mass is not None and abs(mass - stated) > verdict.BEYOND * widths.mass * stated:
        expected = (
            f"within {100.0 * verdict.BEYOND * widths.mass:g} % of the file's {stated:.4g} kg, or a wider --prior"
        )
        raise Refused(f"--mass is {mass:g} kg; expected {expected}{' (g?)' if mass > 100.0 * stated else ''}")


def _print_reasons(
    known: Identified, config: rust.Config, source: Path, signals: Sequence[Signals], prior: Numbers, mass: float | None
) -> None:
    """Print what of a log is not explained, and which mistake would explain it."""
    for row in known.verdict.unexplained:
        print(f"{row.name} is {row.ratio:.1f} times what sensors explain; expected at most {row.bound:.1f}")
    for conflict in known.verdict.conflicts:
        print(f"{conflict} is more than the file's stated error allows")
    found = mistake(known, config, source, signals, prior, mass)
    print("no usual mistake explains it" if found is None else f"it would be explained by {found}")


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
    weight = identify.scale_of(model)[0]
    carried = prior._replace(wrench=np.maximum(prior.wrench, weight * np.eye(6)[2]))
    again = identify_robot(config, source, signals[:1], carried, mass)
    load = float(numbers_of(model, again.found.value).wrench[2])
    if load < verdict.LOAD * weight or again.verdict.unexplained:
        return None
    return f"a load of {load:.0f} N on the feet, or a rope"


def proposals(config: rust.Config, known: Identified) -> list[tuple[str, str, str]]:
    """Return what a log of each manoeuvre of one axis would add, the best first; each is flown in the experiment."""
    robot, found = known.robot, known.found
    rows, names = [], [name for name, *_ in labels(robot)]
    numbers = numbers_of(robot, found.value)
    with tempfile.TemporaryDirectory() as folder:
        for axis in excite.AXES:
            log = rust.fly(excite.flight(config, [axis], Path(folder))).log
            more, _ = samples.sample(log, config, rust.Robot(config["robot"]))
            left = identify.expected(known.model, numbers, found, more, samples.PERIOD)
            asked = found.prior > 0.0
            remains = float(np.exp(np.mean(np.log(left[asked] / found.deviation[asked]))))
            newly = asked & (found.share < FOUND) & (left < np.sqrt(0.5) * found.prior)
            rows.append((remains, axis, ", ".join(names[place] for place in np.flatnonzero(newly)) or "none"))
    table = [(f"--excite {axis}", f"{100.0 * remains:.0f} %", newly) for remains, axis, newly in sorted(rows)]
    return [("a log of", "intervals left, geometric mean", "found besides"), *table]


def prior_of(robot: RobotModel, widths: Perturbation, wind: float = 0.0) -> Numbers:
    """Return prior standard deviations: those of uniform distributions with these half widths; `wind` is that of it."""
    jets, joints, links = robot.jets.count, robot.n_joints, robot.aero_links.count
    deviation, (weight, radius) = 1.0 / np.sqrt(3.0), identify.scale_of(robot)
    has_bodies = float(widths.mass > 0.0 and joints > 0)
    com, inertia = _of_whole(robot, _bodies(robot, LOAD))
    return Numbers(
        mass=np.asarray(widths.mass * deviation),
        com=np.hypot(widths.com * deviation, has_bodies * com) * (widths.com > 0.0),
        inertia=np.hypot(widths.inertia * deviation, has_bodies * inertia) * (widths.inertia > 0.0),
        bodies=_bodies(robot) * has_bodies,
        fuel=np.asarray(FUEL),
        thrust_gain=np.full(jets, widths.thrust_gain * deviation),
        thrust_offset=OFFSET * np.asarray(robot.jets.thrust_max),
        thrust_axes=np.full((jets, 2), np.radians(widths.thrust_axis_deg) * deviation),
        torque_gain=np.full(len(robot.joint_groups), TORQUE_GAIN * deviation),
        imu=np.full(3, np.radians(widths.imu_deg) * deviation),
        gyro=np.full(3, GYRO),
        encoders=np.full(joints, np.radians(widths.encoders_deg) * deviation),
        friction=np.full(joints, widths.friction * deviation),  # from zero to the greatest
        damping=np.asarray(DAMPING if joints else 0.0),
        air=np.full(links, np.hypot(widths.drag, widths.link) * deviation),
        air_turn=np.full((links, 3), TURNED[0]),
        air_point=np.full((links, 3), TURNED[1]),
        wrench=weight * np.repeat([CONSTANT[0], CONSTANT[1] * radius], 3),
        wind=np.full(3, wind),
        delay=np.array([DELAY, np.hypot(DELAY, widths.latency * deviation) if joints else 0.0]),
    )


def _bodies(robot: RobotModel, load: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the deviations of bodies' numbers (nb, 10): of the heavy ones, and of what the heaviest may carry."""
    masses = np.asarray(robot.masses)
    found: Array = np.repeat(BODIES, [1, 3, 6]) * (masses > HEAVY * masses.sum())[:, None] / np.sqrt(3.0)
    heaviest = masses.argmax()
    carried = load[0] / masses[heaviest] / np.sqrt(3.0)
    found[heaviest, :4] = np.hypot(found[heaviest, :4], carried * np.array([1.0, *[load[1]] * 3]))
    return found


def _of_whole(robot: RobotModel, bodies: Array) -> tuple[Array, float]:
    """Return by how much bodies that deviate so change centre of mass and inertia, as `Numbers` has them."""
    kin = kinematics_at_rest(robot, jnp.zeros(robot.n_joints))
    masses = np.asarray(robot.masses)
    arms = np.asarray(kin.body_positions + rotate(kin.body_rotations, jnp.asarray(robot.coms)) - kin.com)
    heavier, moved = (masses * bodies[:, 0])[:, None], masses[:, None] * bodies[:, 1:4].mean(axis=1, keepdims=True)
    com: Array = np.sqrt(np.sum((heavier * arms) ** 2 + moved**2, axis=0)) / masses[0]
    squares = np.sum((2.0 * heavier * np.sum(arms**2, axis=1, keepdims=True)) ** 2 + np.sum((4.0 * moved * arms) ** 2))
    return com, float(np.sqrt(squares) / np.trace(np.asarray(robot.inertias), axis1=1, axis2=2).sum())


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
            load = identify.unexplained(model, zero, one)[:, 2] / identify.scale_of(robot)[0]
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
    found = identify.estimate(model, every, samples.PERIOD, prior, weighed, known=known)
    names = [name for name, *_ in labels(robot)]
    judged = verdict.judge(model, numbers_of(robot, found.value), found, every, again, known, names)
    return Identified(model, every, found, judged, left_out, known)


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


def numbers_of(robot: RobotModel, rows: Array) -> Numbers:
    """Return a vector (p,) of values, or of deviations or shares, by name."""
    left = list(rows)
    shapes = {name: np.shape(value) for name, value in prior_of(robot, Perturbation())._asdict().items()}
    parts = {}
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        parts[name], left = np.reshape(left[:size], shape), left[size:]
    return Numbers(**parts)


def labels(robot: RobotModel) -> list[tuple[str, str, float]]:
    """Return name, unit and factor to it of every number, in order."""
    jets, joints, xyz = robot.jets.names, robot.joint_names, "xyz"
    entries: dict[str, Sequence[str]] = {
        "com": xyz, "thrust_gain": jets, "thrust_offset": jets, "imu": xyz, "encoders": joints, "friction": joints,
        "air": robot.aero_links.names,
        "bodies": [f"{body}.{part}" for body in robot.body_names for part in BODY],
        "torque_gain": [name for name, _ in robot.joint_groups], "gyro": xyz,
        **{name: [f"{link}.{axis}" for link in robot.aero_links.names for axis in xyz] for name in MANY[1:]},
        "thrust_axes": [f"{jet}.{number}" for jet in jets for number in (1, 2)],
        "wrench": ["fx", "fy", "fz", "mx", "my", "mz"], "wind": xyz, "delay": ["thrust", "torque"],
    }  # fmt: skip
    found = []
    for name in Numbers._fields:
        unit, factor = UNITS[name]
        found += [(f"{name}.{entry}" if entry else name, unit, factor) for entry in entries.get(name, [""])]
    return found


def _places(robot: RobotModel, found: Found, words: Sequence[str]) -> NDArray[np.bool_]:
    """Return which numbers these words of `--only` show, of those that the data may determine."""
    names = {name for word in words for name in GROUPS[word]}
    return np.array([label.split(".")[0] in names for label, *_ in labels(robot)]) & (found.prior > 0.0)


def records(robot: RobotModel, found: Found, shown: NDArray[np.bool_]) -> list[Record]:
    """Return the numbers as data, in their units: value, interval, deviation before, share of the data."""
    rows, (low, middle, high) = [], estimates(robot, found)
    for place in np.flatnonzero(shown):
        name, unit, factor = labels(robot)[place]
        rows.append(
            {
                "name": name,
                "value": factor * float(middle[place]),
                "interval": [factor * float(low[place]), factor * float(high[place])],
                "unit": unit,
                "prior": factor * float(found.prior[place]),
                "share": float(found.share[place]),
                "found": bool(found.share[place] >= FOUND),
            }
        )
    return rows


def correlations(robot: RobotModel, found: Found, shown: NDArray[np.bool_]) -> list[tuple[str, str, float]]:
    """Return the numbers that are found and the correlations of their errors, those of `RELATED` and above."""
    places = np.flatnonzero(shown & (found.share >= FOUND))
    names = [labels(robot)[place][0] for place in places]
    deviation = found.deviation[places]
    matrix = found.covariance[np.ix_(places, places)] / np.outer(deviation, deviation)
    pairs = np.argwhere(np.triu(np.abs(matrix) >= RELATED, 1)).tolist()
    return [(names[row], names[column], round(float(matrix[row, column]), 3)) for row, column in pairs]


def estimates(robot: RobotModel, found: Found) -> tuple[Array, Array, Array]:
    """Return of all numbers the lower ends of their intervals, `INTERVAL` likely, their medians, and the upper ends."""
    low, middle, high = quantiles(robot, found, (0.5 - 0.5 * INTERVAL, 0.5, 0.5 + 0.5 * INTERVAL))
    return low, middle, high


def quantiles(robot: RobotModel, found: Found, probabilities: Sequence[float]) -> list[Array]:
    """Return the values below which all numbers are with these probabilities.

    Errors of a file are uniform in `UNIFORM`, of friction from zero, so that what the data alone give is cut there.
    """
    is_free = found.prior > 0.0
    before, after = np.where(is_free, found.prior, 1.0), np.where(is_free, found.deviation, 1.0)
    names = [name.split(".")[0] for name, *_ in labels(robot)]
    half = np.sqrt(3.0) * before
    least = np.where([name == "friction" for name in names], 0.0, -half)
    precision = np.maximum(after**-2 - before**-2, 1e-9 * before**-2)
    alone, spread = found.value * after**-2 / precision, precision**-0.5
    is_cut = np.array([name in UNIFORM for name in names]) & is_free
    is_cut &= (alone + 2.0 * spread >= least) & (alone - 2.0 * spread <= half)
    edges = [np.where(is_cut, ndtr((edge - alone) / spread), outer) for edge, outer in ((least, 0.0), (half, 1.0))]
    centre, width = np.where(is_cut, alone, found.value), np.where(is_cut, spread, found.deviation)
    return [centre + width * ndtri(edges[0] + part * (edges[1] - edges[0])) for part in probabilities]


def describe(row: Record) -> str:
    """Return a number with its interval."""
    low, high = row["interval"]
    return f"{row['value']:.3g} ({low:.3g} to {high:.3g}) {row['unit']}"


def tested(judged: Verdict) -> list[tuple[str, ...]]:
    """Return the table of what was predicted."""
    table: list[tuple[str, ...]] = [
        ("held out, rms", "measured", "file leaves", "numbers leave", "over noise", "at most")
    ]
    for row in judged.rows:
        parts = (f"{part:.3g} {row.unit}" for part in (row.measured, row.file, row.found))
        table.append((row.name, *parts, f"{row.ratio:.2f}", f"{row.bound:.2f}"))
    return table


def _draw(known: Identified, out: Path) -> None:
    """Draw measured and predicted accelerations of the base in the held-out part of the last log."""
    from jax_aero.figures import style

    style.use()
    count = known.known[-1]
    end = Samples(*(part[count:] for part in known.logs[-1]))
    numbers = numbers_of(known.robot, known.found.value)
    mass = identify.mass_matrices(known.model, numbers, end)
    measured = verdict.measured(end)[:, :6]
    figure = style.figure(6.0)
    panels = figure.subplots(6, 1, sharex=True)
    time = samples.PERIOD * np.arange(len(measured))
    lefts = (known.found.residuals[-1][0][count:], known.found.held_out[-1][0])
    for label, left, colour in zip(("file", "found"), lefts, (style.VERMILION, style.BLUE), strict=True):
        predicted = measured - verdict.accelerations(mass, left)[:, :6]
        for row, axes in enumerate(panels):
            axes.plot(time, predicted[:, row], color=colour, label=f"predicted, {label}", linewidth=1.0)
    for row, (axes, name) in enumerate(zip(panels, ("x", "y", "z", "x", "y", "z"), strict=True)):
        axes.plot(time, measured[:, row], color=style.BLACK, label="measured", linewidth=0.8)
        axes.set_ylabel(f"{name} [{'m/s²' if row < 3 else 'rad/s²'}]", fontsize=8)
    panels[0].legend(fontsize=7, ncols=3)
    panels[-1].set_xlabel("time in the held-out part [s]", fontsize=8)
    figure.savefig(out, dpi=150)


def _excite(given: argparse.Namespace) -> int:
    axes = given.excite.split(",")
    if unknown := [axis for axis in axes if axis not in excite.AXES]:
        raise Refused(f"--excite has `{unknown[0]}`; expected some of {', '.join(excite.AXES)}")
    experiment = study.find("experiments", given.experiment or "robot")
    changes = {} if given.robot is None else {"robot": str(Path(given.robot).resolve())}
    config = rust.load_config(experiment, changes)
    folder = (given.out or places.RESULTS / "identify") / (given.named or f"excite_{'_'.join(axes)}")
    with complete_folder(folder, replace=given.overwrite) as draft:
        excite.write(draft / "excite.csv", excite.reference_of(config, axes, *excite.SPAN))
        none = dict.fromkeys((name for name, given in config["mission"].items() if given and name != "file"), ())
        mission = {"base": str(experiment.resolve()), **changes, "mission": {"file": "excite.csv", **none}}
        mission["wind"] = {"base": str(study.find("wind", given.wind))}
        text = plain_values.toml(mission | {"simulator": {"duration": excite.SPAN[1] + 2.0}})
        (draft / "excite.toml").write_text(text + "\n", encoding="utf-8")
    print(f"fly it: jax-aero fly {folder / 'excite.toml'}")
    return 0
