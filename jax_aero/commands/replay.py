"""Replay a recorded log through the tick of a controller, open loop, and compare what it computes with the log.

LOG is a result of `jax-aero fly`, an MCAP, MATLAB or CSV file of `jax-aero export`, or one of others (parquet too) with
--map FILE. The log of a flight of the crate with its own configuration gives the same bits; otherwise the differences
of every signal are printed, and with --plot drawn, and the exit status is 1, unless all are within --tolerance. Ticks
that the log has lost are replayed as not measured. Where a rounding of the log changes the torques, the controller's
own memory does not reproduce, and nothing is compared from then on.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import replay, rust
from jax_aero.base import arguments
from jax_aero.base.files import complete_file
from jax_aero.base.keys import parse_assignments
from jax_aero.base.result import match_branch
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.results import study
from jax_aero.results.table import text_table
from jax_aero.view import check_out, logs
from jax_aero.view.export import column_name, write_csv
from jax_aero.view.recording import Recording, entries_of

Array = NDArray[np.float64]

FORMATS = (".png", ".pdf", ".svg")
PANELS = 6
"""Greatest number of signals in the figure."""


class Difference(NamedTuple):
    """Difference of a signal that was replayed from that of the log.

    Attributes
    ----------
    greatest
        Greatest absolute difference; NaN where only one of both is a number.
    time
        When it is reached [s].
    range
        Greatest absolute value in the log.
    """

    signal: str
    greatest: float
    time: float
    range: float


def main(words: Sequence[str]) -> int:
    """Replay a log; return the exit status."""
    parser = arguments.Parser("replay", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help="result, or .mcap, .mat or .csv file")
    about = "experiment with the robot, mission and controller (default: what the log was flown with)"
    parser.add_argument("--experiment", metavar="NAME", help=about)
    parser.add_argument("--controller", metavar="NAME", help="another one, of configs/control, or its file")
    parser.add_argument("--robot", metavar="FILE", help="robot file, for a log of a robot of your own")
    study.add_set(parser)
    parser.add_argument("--map", type=Path, metavar="FILE", help="TOML file that names the columns of a log of others")
    about = "greatest difference, in ranges of a signal, with which it agrees (default 0: the same bits)"
    parser.add_argument("--tolerance", type=arguments.share, default=0.0, metavar="SHARE", help=about)
    parser.add_argument("--plot", type=Path, metavar="FILE", help=f"draw what differs most ({', '.join(FORMATS)})")
    parser.add_argument("--out", type=Path, metavar="FILE", help="keep what is computed (.csv)")
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    given = parser.parse_args(words)
    return exit_status(lambda: _replay(given))


def _replay(given: argparse.Namespace) -> int:
    for option, path, formats in (("--plot", given.plot, FORMATS), ("--out", given.out, (".csv",))):
        if path is not None:
            check_out(path, *formats)
            if path.exists() and not given.overwrite:
                raise Refused(f"`{path}` is there already; choose another {option}, or --overwrite it")
    changes = parse_assignments(given.set)
    named = None if given.experiment is None else rust.load_config(given.experiment)
    log = logs.read(given.log, named, given.map, given.robot)
    config = named or log.config
    if config is None:
        raise Refused(f"`{given.log}` does not hold the configuration of a flight; expected --experiment NAME")
    if given.robot is not None:
        config = {**config, "robot": str(Path(given.robot).resolve())}
    if given.controller is not None:
        config = {**config, "controller": rust.load_controller(given.controller)}
    config = rust.set_keys(config, changes)
    recorded, computed = replay.replay(log, config, given.log)
    differences = compare(recorded, computed)
    print(f"{computed['time'].size} ticks of {given.log}")
    if any(difference.greatest != 0.0 for difference in differences):
        until = replay.ticks_reproduced(log, config, given.log, computed)
        if until < computed["time"].size:
            print(
                f"not compared from {computed['time'][until]:.2f} s on: the controller's own memory does not "
                "reproduce, since a rounding of the log changes its torques"
            )
            recorded, computed = ({name: rows[:until] for name, rows in of.items()} for of in (recorded, computed))
            differences = compare(recorded, computed)
    print(describe(differences))
    apart = [difference for difference in differences if share(difference) > given.tolerance]
    if given.tolerance:
        count = len(differences) - len(apart)
        print(f"within {given.tolerance:g} of their ranges: {count} of {len(differences)} signals")
    if given.out is not None:
        robot = rust.Robot(config["robot"])
        write_csv(Recording("replay", computed, robot, Path(config["robot"]), "replayed", None, None), given.out)
        print(given.out)
    if given.plot is not None:
        _draw(recorded, computed, differences, rust.Robot(config["robot"]), given.plot)
        print(given.plot)
    return int(bool(apart))


def compare(recorded: Mapping[str, Array], computed: Mapping[str, Array]) -> list[Difference]:
    """Return the difference of every signal that both hold and that is no input, by their share of its range."""
    differences = []
    for name, after in computed.items():
        if rust.is_input(name) or name not in recorded:
            continue
        before = match_branch(name, recorded[name], after)
        # Where neither is a number, or both are the same infinity, they agree.
        agrees = (before == after) | (np.isnan(before) & np.isnan(after))
        with np.errstate(invalid="ignore"):
            error = np.where(agrees, 0.0, np.abs(after - before)).reshape(len(before), -1)
        worst = np.where(np.isnan(error), np.inf, error).max(axis=1, initial=0.0)
        tick = int(worst.argmax())
        greatest = np.nan if np.isinf(worst[tick]) else float(worst[tick])
        range_ = np.abs(before[np.isfinite(before)]).max(initial=0.0)
        differences.append(Difference(name, greatest, float(computed["time"][tick]), float(range_)))
    return sorted(differences, key=share, reverse=True)


def share(difference: Difference) -> float:
    """Return the share of the range that a signal differs by; infinite for one that is no number on one side only."""
    if difference.greatest == 0.0:
        return 0.0
    return float(np.nan_to_num(difference.greatest / max(difference.range, 1e-300), nan=np.inf))


def describe(differences: Sequence[Difference]) -> str:
    """Return a table of the signals that differ, or that none does."""
    apart = [difference for difference in differences if difference.greatest != 0.0]
    equal = f"equal to the last bit: {len(differences) - len(apart)} of {len(differences)} signals"
    if not apart:
        return equal
    rows = [
        (one.signal, f"{one.greatest:.3g}", f"{one.range:.3g}", f"{one.time:.2f}", rust.signals()[one.signal].unit)
        for one in apart
    ]
    return text_table([("signal", "greatest difference", "range", "time [s]", "unit"), *rows]) + f"\n{equal}"


def _draw(
    recorded: Mapping[str, Array],
    computed: Mapping[str, Array],
    differences: Sequence[Difference],
    robot: rust.Robot,
    out: Path,
) -> None:
    """Draw the signals that differ most, without those of the solvers: of each the entry that differs most."""
    from jax_aero.figures import style

    style.use()
    shown = [one for one in differences if "qp" not in rust.signals()[one.signal].dims][:PANELS]
    figure = style.figure(1.4 * max(len(shown), 1) + 0.6)
    time = computed["time"]
    for axes, one in zip(np.ravel(figure.subplots(max(len(shown), 1), sharex=True)), shown, strict=True):
        before, after = (np.reshape(signals[one.signal], (time.size, -1)) for signals in (recorded, computed))
        entry = int(np.nan_to_num(np.abs(after - before)).max(axis=0).argmax())
        axes.plot(time, before[:, entry], color=style.GREY, label="log")
        axes.plot(time, after[:, entry], color=style.VERMILION, linestyle="--", label="replay")
        name = column_name(one.signal, entries_of(one.signal, robot)[entry])
        axes.set_title(f"{name} [{rust.signals()[one.signal].unit}]", fontsize=8, loc="left")
        axes.tick_params(labelsize=7)
        axes.set_xlabel("time [s]", fontsize=8)
        axes.legend(fontsize=7, loc="upper right")
        axes.label_outer()
    with complete_file(out) as draft:
        figure.savefig(draft, dpi=150)
