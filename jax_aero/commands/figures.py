"""Draw figures of finished flights and sweeps as PDF and PNG; of all, those whose results are there."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from jax_aero.base import arguments, places
from jax_aero.base.quantities import COLUMNS
from jax_aero.base.terminal import REFUSED
from jax_aero.figures import drawings, runs, style, sweeps
from jax_aero.figures.catalogue import FIGURES, SWEEPS
from jax_aero.stored import outdated
from jax_aero.sweep.result import is_finished


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    given = _parser().parse_args(arguments)
    finished = {path.parent.name for path in (given.results / "sweeps").glob("[!.]*/cells.parquet")}
    known = [*FIGURES, *SWEEPS, *sorted(finished - {*SWEEPS, *FIGURES})]
    is_all = given.names in ([], ["all"])
    names = [name for name in known if not _is_of_any(name)] if is_all else given.names
    if unknown := [name for name in names if name not in known]:
        others = "" if places.IS_CHECKOUT else "; those of the paper and of studies are in a checkout of the repository"
        print(f"error: no figure `{unknown[0]}`{places.did_you_mean(unknown[0], known)}{others}", file=sys.stderr)
        return REFUSED
    style.use()
    missing = 0
    for name in names:
        if wrong := _wrong_number(name, given.runs or (), given.labels or ()):
            print(f"error: {wrong}", file=sys.stderr)
            return REFUSED
        try:
            stale = _check(name, given)
            figure, hashes = _draw(name, given)
        except runs.NotDrawn as reason:
            missing += 1
            if not is_all:
                print(f"error: {name}: {reason}", file=sys.stderr)
            continue
        if stale:
            figure.text(
                0.01, 0.01, f"made otherwise than today: {stale}", va="bottom", size="small", color=style.VERMILION
            )
        for path in style.save(figure, _file_name(name, given), given.out, hashes, dark=given.dark):
            print(path)
    hidden = [name for name in names if name in FIGURES and is_finished(given.results / "sweeps" / name)]
    for name in hidden:
        print(f"error: the sweep {name} is not drawn, since a figure has its name; give it another", file=sys.stderr)
    if missing:
        why = "; each says by its name what it needs" if is_all else ""
        print(f"{missing} of {len(names)} figures were not drawn{why}", file=sys.stderr)
    return 1 if (missing and not is_all) or hidden else 0


def _is_of_any(name: str) -> bool:
    return name in FIGURES and FIGURES[name].is_of_any


def _wrong_number(name: str, chosen: Sequence[str], labels: Sequence[str]) -> str:
    """Return what is wrong with the number of the runs that are asked for, or of labels; empty if nothing is."""
    shown = chosen or (FIGURES[name].runs if name in FIGURES else ())
    if labels and len(labels) != len(shown):
        return f"{name} has {len(shown)} runs, not {len(labels)} as --labels"
    if _is_of_any(name):
        return "" if chosen else f"{name} shows the flights of --runs, and none is named"
    expected = len(FIGURES[name].runs) if name in FIGURES else 0
    return f"{name} shows {expected} runs, not {len(chosen)}" if chosen and len(chosen) != expected else ""


def _check(name: str, given: argparse.Namespace) -> str:
    """Return which results of a figure differ from today's configuration and code; refuse them without --stale."""
    if name in FIGURES:
        kind, chosen = FIGURES[name].kind, FIGURES[name].folders(given.results, given.runs or ())
    else:
        kind, chosen = "sweeps", [given.results / "sweeps" / name]
    differences = {folder.name: outdated.result(kind, folder) for folder in chosen if folder.is_dir()}
    stale = "; ".join(f"{folder} ({differs})" for folder, differs in differences.items() if differs)
    if stale and not given.stale:
        raise runs.NotDrawn(
            f"made of another configuration or numerics than today's: {stale}; make it again, or --stale"
        )
    return stale


def _draw(name: str, given: argparse.Namespace) -> tuple[Figure, dict[str, str]]:
    if name in FIGURES:
        return FIGURES[name].draw_from_results(given.results, given.runs or (), given.labels or ())
    sweep = sweeps.load(given.results / "sweeps", name, given.of or ())
    return drawings.draw(sweep, given.paired), sweep.hashes


def _file_name(name: str, given: argparse.Namespace) -> str:
    """Return the file name of a figure, with a suffix if it shows other results than its own, or differences."""
    if name not in FIGURES:
        shown = f"paired_{given.paired}" if given.paired else "_".join(given.of or ())
        return f"{name}--{shown}" if shown else name
    if not given.runs or tuple(given.runs) == FIGURES[name].runs:
        return name
    return name + places.addition("--" + "_".join(Path(run).name for run in given.runs))


def _parser() -> argparse.ArgumentParser:
    listed = "figures, and the runs that fill them:\n" + "\n".join(
        f"  {name:<18}{entry.shows}; {' '.join(entry.runs) or ('--runs' if entry.is_of_any else 'none')}"
        for name, entry in FIGURES.items()
    )
    parser = arguments.Parser("figures", __doc__, epilog=listed)
    named = parser.add_argument("names", nargs="*", metavar="FIGURE", help="figures or sweeps (default: all)")
    arguments.complete_with(named, lambda: [*FIGURES, *SWEEPS, "all"])
    parser.add_argument(
        "--stale",
        action="store_true",
        help="draw results of another configuration or numerics too, and say so there",
    )
    parser.add_argument(
        "--paired", metavar="AXIS", help="of sweeps: differences of an axis' levels to the first one, on the same draws"
    )
    parser.add_argument(
        "--of",
        nargs="+",
        metavar="COLUMN",
        choices=COLUMNS,
        help="of sweeps: figures of merit to draw (default: errors)",
    )
    parser.add_argument("--dark", action="store_true", help="also write NAME_dark.png, for a dark page")
    parser.add_argument(
        "--runs", nargs="+", metavar="RUN", help="runs that the figure shows, in its order: names, or folders"
    )
    parser.add_argument(
        "--labels", nargs="+", metavar="TEXT", help="names of the runs in legends and titles; $...$ is mathematics"
    )
    arguments.add_results(parser)
    parser.add_argument("--out", type=Path, default=places.RESULTS / "figures", metavar="DIR", help="where figures go")
    return parser
