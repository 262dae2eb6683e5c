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
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import arguments, places, plain_values, tables
from jax_aero.base.files import complete_folder
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.identify import excite, motion, result, samples, verdict
from jax_aero.identify.identified import Identified, identify_robot, mistake, proposals
from jax_aero.identify.motion import Numbers, Samples
from jax_aero.identify.numbers import FOUND, MANY, Record, correlations, describe, labels, records
from jax_aero.identify.prior import WIND, numbers_of, prior_of
from jax_aero.identify.search import Found
from jax_aero.identify.verdict import Verdict
from jax_aero.results import study
from jax_aero.results.table import text_table
from jax_aero.sweep.perturbation import Perturbation
from jax_aero.view import logs

Array = NDArray[np.float64]
Signals = Mapping[str, Array]

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
        shown = _places(known.robot, known.found, words)
        rows = records(known.robot, known.found, shown)
        wind = "measured" if has_wind else "taken as none" if given.still_air else "found as constant"
        with complete_folder(folder, replace=given.overwrite) as draft:
            _write(draft, known, rows, shown, _digest(signals), wind)
            if known.verdict.is_explained or given.anyway:
                _write_robot(draft, known, rows, shown, _digest(signals), config, source)
        _print_verdict(known, wind)
        if not known.verdict.is_explained:
            _print_reasons(known, config, source, signals, prior, given.mass)
            if not given.anyway:
                print(f"{folder / 'numbers.json'}: the log is not explained; no robot is written without --anyway")
                return 1
    _print_numbers(known, rows)
    if config["controller"]["fault_detection"].get("latency"):
        computed = rust.replay({**config, "robot": str(folder / "robot.toml"), "disturbances": {}}, signals[0])
        for key, (median, deviation) in samples.latencies(computed).items():
            print(f"latency of the {key}s by the controller's monitor: {1e3 * median:.1f} ± {1e3 * deviation:.1f} ms")
    if given.propose:
        with jax.enable_x64(True):
            print(text_table(proposals({**config, "robot": str(source), "disturbances": {}}, known)))
    print(f"fly it: jax-aero fly {folder / 'experiment.toml'}")
    return int(not known.verdict.is_explained)


def _digest(signals: Sequence[Signals]) -> str:
    """Return the SHA-256 of what of the logs is used."""
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(log[name]).tobytes() for log in signals for name in samples.MEASURED)
    ).hexdigest()


def _write(
    draft: Path, known: Identified, rows: Sequence[Record], shown: NDArray[np.bool_], digest: str, wind: str
) -> None:
    """Write numbers, verdict and the figure of the held-out part."""
    facts = {
        "sha256": digest,
        "explained": known.verdict.is_explained,
        "wind": wind,
        "samples": sum(int(np.sum(log.weight)) for log in known.logs),
        "left_out": known.left_out,
        "conflicts": known.verdict.conflicts,
        "held_out": [row._asdict() for row in known.verdict.rows],
        "numbers": rows,
        "correlations": correlations(known.robot, known.found, shown),
    }
    (draft / "numbers.json").write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    _draw(known, draft / "held_out.png")


def _write_robot(
    draft: Path,
    known: Identified,
    rows: Sequence[Record],
    shown: NDArray[np.bool_],
    digest: str,
    config: rust.Config,
    source: Path,
) -> None:
    """Write the robot that the shown numbers make, an experiment with it, and what is left unknown."""
    robot, estimate = known.robot, known.found
    numbers = numbers_of(robot, np.where(shown, estimate.value, 0.0))
    is_found = numbers_of(robot, (shown & (estimate.share >= FOUND)).astype(float))
    notes = [
        f"Found by jax-aero identify in logs with sha256 {digest}.",
        *([] if known.verdict.is_explained else ["The model does not explain the log."]),
        *(f"{row['name']}: {describe(row)}" for row in rows),
    ]
    result.write_perturbation(draft, numbers_of(robot, estimate.deviation))
    result.write_experiment(draft, config, robot, numbers, is_found)
    result.write_robot(draft, source, known.model, numbers, notes)


def _print_verdict(known: Identified, wind: str) -> None:
    """Print what of the logs is left out, and how well the numbers predict what was held out."""
    for reason, count in known.left_out.items():
        print(f"{count} of {sum(len(log.weight) for log in known.logs)} samples left out: {reason}")
    print(f"wind: {wind}")
    print(text_table(tested(known.verdict)))
    print(f"numbers leave {known.verdict.improvement:.2g} times less of the base's accelerations than the file")


def _print_numbers(known: Identified, rows: Sequence[Record]) -> None:
    """Print the numbers, but for those of kinds with many of which nothing is found; and what is least known."""
    few = [row for row in rows if row["found"] or row["name"].split(".")[0] not in MANY]
    table = [(row["name"], describe(row), f"{row['share']:.2f}{'' if row['found'] else ', not found'}") for row in few]
    print(text_table([("difference from the file", "value, 95 % interval", "share of the data"), *table]))
    names = [name for name, *_ in labels(known.robot)]
    for share, direction in known.found.undetermined():
        largest = np.argsort(-np.abs(direction))[:4]
        mix = " ".join(f"{direction[place]:+.2f} {names[place]}" for place in largest if abs(direction[place]) > 0.1)
        print(f"{100.0 * share:.0f} % of the prior's variance is left along {mix}")


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
    explanation = mistake(known, config, source, signals, prior, mass)
    print("no usual mistake explains it" if explanation is None else f"it would be explained by {explanation}")


def _places(robot: RobotModel, estimate: Found, words: Sequence[str]) -> NDArray[np.bool_]:
    """Return which numbers these words of `--only` show, of those that the data may determine."""
    names = {name for word in words for name in GROUPS[word]}
    return np.array([label.split(".")[0] in names for label, *_ in labels(robot)]) & (estimate.prior > 0.0)


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
    mass = motion.mass_matrices(known.model, numbers, end)
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
