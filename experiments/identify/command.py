"""Find a robot's numbers in its own logs, and write the robot that they make.

LOG is what `jax-aero replay` reads: a result of `jax-aero fly`, an MCAP, MATLAB or CSV file. The last fifth of each is
held out. Every number is shown with its 90 % interval and the share of the data in it; below half it is not found.

`results/identify/NAME/` holds `robot.toml`, which builds on the old file, `experiment.toml`, which flies it in a world
with what was found of sensors, drives and engines, `perturbation.toml` of what is left unknown, `numbers.json` and
`held_out.png`. With --excite AXES, in place of LOG, it holds a mission that moves these axes, `excite.toml`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from experiments import Refused, study
from experiments.identify import excite, result, samples
from experiments.sweep.perturbation import Perturbation
from experiments.table import text_table
from jax_aero import cli, rust
from jax_aero.aero import aero_model
from jax_aero.base import places, plain, tables
from jax_aero.base.files import complete_folder
from jax_aero.base.terminal import exit_status
from jax_aero.base.typed import scenario_config
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.train import identify
from jax_aero.train.identify import Found, Numbers
from jax_aero.view import logs

Array = NDArray[np.float64]

GROUPS = {
    "masses": ("mass", "com", "inertia"),
    "axes": ("thrust_axes",),
    "engines": ("thrust_gain", "thrust_offset"),
    "sensors": ("imu", "encoders"),
    "drives": ("friction", "damping"),
    "air": ("air", "wrench"),
}
"""Numbers by the word of `--only`."""
UNITS = {
    "mass": ("%", 100.0),
    "com": ("mm", 1e3),
    "inertia": ("%", 100.0),
    "thrust_gain": ("%", 100.0),
    "thrust_offset": ("N", 1.0),
    "thrust_axes": ("deg", np.degrees(1.0)),
    "imu": ("deg", np.degrees(1.0)),
    "encoders": ("deg", np.degrees(1.0)),
    "friction": ("N m", 1.0),
    "damping": ("N m s", 1.0),
    "air": ("%", 100.0),
    "wrench": ("N, N m", 1.0),
}
INTERVAL = 1.645
"""Half width of the 90 % interval in standard deviations."""
HELD_OUT = 0.2
"""Share of every log, at its end, that is predicted."""
SCALE_ERROR = 0.05
"""Standard deviation of a weighing [kg]."""
UNMODELLED = (1.0, 1.0, 1.0, 0.3, 0.3, 0.3)
"""Standard deviation of a constant force and moment that no number explains [N, N m]: a network's air less its fit."""
OFFSET = 2.0
"""Of a thrust sensor's offset [N]: half of the 2 % of Momin et al., ICRA 2022."""
DAMPING = 0.5
"""Of the drives' viscous friction [N m s]: that of `simulator/robot.toml`."""


def main(words: Sequence[str]) -> int:
    """Identify, or write a mission; return the exit status."""
    parser = cli.Parser("identify", __doc__)
    parser.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="result, or .mcap, .mat or .csv file")
    about = "experiment with the controller and the world (default: what the first log was flown with)"
    parser.add_argument("--experiment", metavar="NAME", help=about)
    parser.add_argument("--robot", metavar="FILE", help="robot file to start from (default: that of the experiment)")
    parser.add_argument("--map", type=Path, metavar="FILE", help="TOML file that names the columns of a log of others")
    parser.add_argument("--mass", type=float, metavar="KG", help="mass of the robot on a scale")
    parser.add_argument("--only", default=",".join(GROUPS), metavar="WORDS", help=f"some of {', '.join(GROUPS)}")
    about = "perturbation whose half widths are the errors of the robot's file (default unknown_robot)"
    parser.add_argument("--prior", default="unknown_robot", metavar="NAME", help=about)
    parser.add_argument("--propose", action="store_true", help="say what a log of each axis in motion would teach")
    parser.add_argument("--excite", metavar="AXES", help=f"write a mission that moves some of {','.join(excite.AXES)}")
    cli.add_name(parser, "that of the first log")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing result")
    given = parser.parse_args(words)
    return exit_status(lambda: _excite(given) if given.excite else _identify(given))


def _identify(given: argparse.Namespace) -> None:
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
    prior = prior_of(load_robot(source), tables.load(study.find("perturbation", given.prior), Perturbation), words)
    signals = [samples.read(path, given.map, config, str(source)) for path in given.logs]
    with jax.enable_x64(True):
        robot, found, ends = identify_robot(config, source, signals, prior, given.mass)
        numbers = numbers_of(robot, found.value)
        report = describe(robot, found)
        digest = hashlib.sha256(
            b"".join(np.ascontiguousarray(log[name]).tobytes() for log in signals for name in samples.MEASURED)
        ).hexdigest()
        folder = places.RESULTS / "identify" / (given.named or given.logs[0].stem)
        with complete_folder(folder, replace=given.overwrite) as draft:
            notes = [f"{name}: {text}" for name, text, *_ in report[1:]]
            notes = [f"Found by jax-aero identify in logs with sha256 {digest}.", *notes]
            result.write_robot(draft, source, robot, Numbers(*numbers), notes)
            result.write_experiment(draft, config, robot, numbers)
            result.write_perturbation(draft, numbers_of(robot, found.deviation))
            rows = {name: list(row) for name, *row in report[1:]}
            (draft / "numbers.json").write_text(json.dumps({"sha256": digest, "numbers": rows}, indent=1) + "\n")
        _draw(robot, config, ends, numbers, folder / "held_out.png")
    print(text_table(report))
    has_monitor = config["controller"]["fault_detection"].get("latency")
    flown = {**config, "robot": str(folder / "robot.toml"), "disturbances": {}}
    computed = rust.replay(flown, signals[0]) if has_monitor else {}
    for key, (median, deviation) in samples.latencies(computed).items():
        print(f"latency of the {key}s, with the lag of what obeys them: {1e3 * median:.1f} ± {1e3 * deviation:.1f} ms")
    for share, direction in found.unlearned():
        largest = np.argsort(-np.abs(direction))[:4]
        names = labels(robot)
        mix = " ".join(f"{direction[place]:+.2f} {names[place][0]}" for place in largest if abs(direction[place]) > 0.1)
        print(f"{100.0 * share:.0f} % of the prior's variance is left along {mix}")
    if given.propose:
        with jax.enable_x64(True):
            print(text_table(proposals({**config, "robot": str(source), "disturbances": {}}, robot, found)))
    print(f"fly it: jax-aero fly {folder / 'experiment.toml'}")


def proposals(config: rust.Config, robot: RobotModel, found: Found) -> list[tuple[str, str, str]]:
    """Return what a log of each manoeuvre of one axis would teach, the best first; each is flown in the experiment."""
    rows, names = [], [name for name, *_ in labels(robot)]
    aero, numbers = aero_model(scenario_config(config).controller.aero, robot), numbers_of(robot, found.value)
    with tempfile.TemporaryDirectory() as folder:
        for axis in excite.AXES:
            log = rust.fly(excite.flight(config, [axis], Path(folder))).log
            left = identify.expected(robot, aero, numbers, found, samples.sample(log, config), samples.PERIOD)
            asked = found.prior > 0.0
            remains = float(np.exp(np.mean(np.log(left[asked] / found.deviation[asked]))))
            newly = asked & (found.share < 0.5) & (left < np.sqrt(0.5) * found.prior)
            rows.append((remains, axis, ", ".join(names[place] for place in np.flatnonzero(newly)) or "none"))
    table = [(f"--excite {axis}", f"{100.0 * remains:.0f} %", newly) for remains, axis, newly in sorted(rows)]
    return [("a log of", "intervals left, geometric mean", "found besides"), *table]


def prior_of(robot: RobotModel, widths: Perturbation, words: Sequence[str] = tuple(GROUPS)) -> Numbers:
    """Return prior standard deviations: those of uniform distributions with these half widths, zero for other words."""
    jets, joints, deviation = robot.jets.count, robot.n_joints, 1.0 / np.sqrt(3.0)
    of = {
        "mass": widths.mass * deviation,
        "com": np.full(3, widths.com * deviation),
        "inertia": widths.inertia * deviation,
        "thrust_gain": np.full(jets, widths.thrust_gain * deviation),
        "thrust_offset": np.full(jets, OFFSET),
        "thrust_axes": np.full((jets, 2), np.radians(widths.thrust_axis_deg) * deviation),
        "imu": np.full(3, np.radians(widths.imu_deg) * deviation),
        "encoders": np.full(joints, np.radians(widths.encoders_deg) * deviation),
        "friction": np.full(joints, widths.friction * deviation),  # from zero to the greatest
        "damping": DAMPING,
        "air": widths.drag,
        "wrench": np.array(UNMODELLED),
    }
    chosen = {name for word in words for name in GROUPS[word]}
    return Numbers(**{name: np.asarray(value) * float(name in chosen) for name, value in of.items()})


def identify_robot(
    config: rust.Config,
    source: Path,
    signals: Sequence[Mapping[str, Array]],
    prior: Numbers,
    mass: float | None,
    robot: RobotModel | None = None,
) -> tuple[RobotModel, Found, list[identify.Samples]]:
    """Return the robot of the file, what the first parts of the logs tell of it, and their last parts.

    `robot` is another model to start from than that of the file.
    """
    controller = scenario_config({**config, "robot": str(source), "disturbances": {}}).controller
    robot = load_robot(source) if robot is None else robot
    robot = replace(robot, rotor_inertia=jnp.asarray(controller.torque.rotor_inertia * robot.joint_turns))
    every = [samples.sample(log, config) for log in signals]
    parts = [int((1.0 - HELD_OUT) * len(one.thrust)) for one in every]
    known, ends = zip(*(_split(one, part) for one, part in zip(every, parts, strict=True)), strict=True)
    weighed = None if mass is None else (mass, SCALE_ERROR)
    aero = aero_model(controller.aero, robot)
    return robot, identify.estimate(robot, aero, known, samples.PERIOD, prior, weighed), list(ends)


def _split(one: identify.Samples, place: int) -> tuple[identify.Samples, identify.Samples]:
    first, second = (
        {name: jnp.asarray(rows[cut]) for name, rows in one._asdict().items()}
        for cut in (slice(place), slice(place, None))
    )
    return identify.Samples(**first), identify.Samples(**second)


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
        "thrust_axes": [f"{jet}.{number}" for jet in jets for number in (1, 2)],
        "wrench": ["fx", "fy", "fz", "mx", "my", "mz"],
    }  # fmt: skip
    found = []
    for name in Numbers._fields:
        unit, factor = UNITS[name]
        found += [(f"{name}.{entry}" if entry else name, unit, factor) for entry in entries.get(name, [""])]
    return found


def describe(robot: RobotModel, found: Found) -> list[tuple[str, str, str]]:
    """Return a table of the numbers that were asked for: value with its interval, share of the data."""
    rows = [("difference from the file", "value, 90 % interval", "share of the data")]
    for place, (name, unit, factor) in enumerate(labels(robot)):
        if found.prior[place] > 0.0:
            value, width, share = (
                factor * found.value[place],
                factor * INTERVAL * found.deviation[place],
                found.share[place],
            )
            text = f"{value:.3g} ({value - width:.3g} to {value + width:.3g}) {unit}"
            rows.append((name, text, f"{share:.2f}" + ("" if share >= 0.5 else ", not found")))
    return rows


def _draw(
    robot: RobotModel, config: rust.Config, ends: Sequence[identify.Samples], numbers: Numbers, out: Path
) -> None:
    """Draw measured and predicted accelerations of the base in the held-out part of the last log."""
    from paper_figs import style

    style.use()
    controller = scenario_config({**config, "disturbances": {}}).controller
    end, aero = ends[-1], aero_model(controller.aero, robot)
    measured = np.concatenate([end.linear_acceleration, np.einsum("kab,kb->ka", end.rotation, end.gyro_rate)], axis=1)
    zero = Numbers(*(np.zeros_like(part) for part in numbers))
    figure = style.figure(6.0)
    panels = figure.subplots(6, 1, sharex=True)
    time = samples.PERIOD * np.arange(len(measured))
    for label, guess, colour in (("file", zero, style.VERMILION), ("found", numbers, style.BLUE)):
        predicted = measured - np.asarray(identify.base_error(robot, aero, guess, end))
        for row, axes in enumerate(panels):
            axes.plot(time, predicted[:, row], color=colour, label=f"predicted, {label}", linewidth=1.0)
    for row, (axes, name) in enumerate(zip(panels, ("x", "y", "z", "x", "y", "z"), strict=True)):
        axes.plot(time, measured[:, row], color=style.BLACK, label="measured", linewidth=0.8)
        axes.set_ylabel(f"{name} [{'m/s²' if row < 3 else 'rad/s²'}]", fontsize=8)
    panels[0].legend(fontsize=7, ncols=3)
    panels[-1].set_xlabel("time in the held-out part [s]", fontsize=8)
    figure.savefig(out, dpi=150)


def _excite(given: argparse.Namespace) -> None:
    axes = given.excite.split(",")
    if unknown := [axis for axis in axes if axis not in excite.AXES]:
        raise Refused(f"--excite has `{unknown[0]}`; expected some of {', '.join(excite.AXES)}")
    experiment = study.find("experiments", given.experiment or "robot")
    changes = {} if given.robot is None else {"robot": str(Path(given.robot).resolve())}
    config = rust.load_config(experiment, changes)
    folder = places.RESULTS / "identify" / (given.named or f"excite_{'_'.join(axes)}")
    with complete_folder(folder, replace=given.overwrite) as draft:
        excite.write(draft / "excite.csv", excite.reference_of(config, axes, *excite.SPAN))
        none = dict.fromkeys((name for name, given in config["mission"].items() if given and name != "file"), ())
        mission = {"base": str(experiment.resolve()), **changes, "mission": {"file": "excite.csv", **none}}
        text = plain.toml(mission | {"simulator": {"duration": excite.SPAN[1] + 2.0}})
        (draft / "excite.toml").write_text(text + "\n", encoding="utf-8")
    print(f"fly it: jax-aero fly {folder / 'excite.toml'}")
