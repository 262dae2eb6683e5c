"""Draw figures of finished flights and sweeps as PDF and PNG; of all, those whose results are there."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from experiments import outdated
from jax_aero import cli
from jax_aero.base import places
from jax_aero.base.quantities import COLUMNS
from jax_aero.base.terminal import Refused
from paper_figs import ablation, front, maps, model_pairs, pairs, runs, scatter, style, sweeps
from paper_figs.figures import FIGURES, SWEEPS

DRAWINGS: Mapping[str, Callable[[sweeps.Sweep], Figure]] = {
    "levels": ablation.draw,
    "curve": ablation.draw,
    "map": maps.draw,
    "scatter": scatter.draw,
    "matrix": model_pairs.draw,
    "pairs": pairs.draw,
    "front": front.draw,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    given = _parser().parse_args(arguments)
    finished = {path.parent.name for path in given.sweeps.glob("*/cells.parquet")}
    known = [*FIGURES, *SWEEPS, *sorted(finished - {*SWEEPS, *FIGURES})]
    is_all = given.names in ([], ["all"])
    names = [name for name in known if not _is_of_any(name)] if is_all else given.names
    if unknown := [name for name in names if name not in known]:
        print(f"error: no figure `{unknown[0]}`{places.did_you_mean(unknown[0], known)}", file=sys.stderr)
        return cli.REFUSED
    style.use()
    missing = 0
    for name in names:
        if wrong := _wrong_number(name, given.runs or (), given.labels or ()):
            print(f"error: {wrong}", file=sys.stderr)
            return cli.REFUSED
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
    hidden = [name for name in names if name in FIGURES and sweeps.is_finished(given.sweeps / name)]
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
        kind, chosen = "sweeps", [given.sweeps / name]
    found = {folder.name: outdated.result(kind, folder) for folder in chosen if folder.is_dir()}
    stale = "; ".join(f"{folder} ({differs})" for folder, differs in found.items() if differs)
    if stale and not given.stale:
        raise runs.NotDrawn(f"made of another configuration or code than today's: {stale}; make it again, or --stale")
    return stale


def _draw(name: str, given: argparse.Namespace) -> tuple[Figure, dict[str, str]]:
    if name in FIGURES:
        return FIGURES[name].draw_from_results(given.results, given.runs or (), given.labels or ())
    sweep = sweeps.load(given.sweeps, name, given.of or ())
    return draw_sweep(sweep, given.paired), sweep.hashes


def draw_sweep(sweep: sweeps.Sweep, axis: str | None = None) -> Figure:
    """Return the figure of a sweep, drawn as its file says, or the paired differences between levels of an axis."""
    texts = [sweep.title, *(axis["label"] for axis in sweep.document["axes"])]
    texts += [level for axis in sweep.document["axes"] for level in axis["levels"] if isinstance(level, str)]
    try:
        # Texts come from files: if one has dollars but no mathematics, they are ordinary characters.
        with mpl.rc_context({"text.parse_math": all(map(style.can_be_typeset, texts))}):
            if axis:
                from paper_figs import paired  # needs pyarrow, which the extra of figures does not bring

                return paired.draw(sweep, axis)
            return DRAWINGS[sweep.document["drawing"]](sweep)
    except Refused as reason:
        raise runs.NotDrawn(str(reason)) from None
    except KeyError as missing:
        raise runs.NotDrawn(f"its tables have no {missing}; --overwrite flies it again") from None


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
    parser = cli.Parser("figures", __doc__, epilog=listed)
    named = parser.add_argument("names", nargs="*", metavar="FIGURE", help="figures or sweeps (default: all)")
    cli.complete_with(named, lambda: [*FIGURES, *SWEEPS, "all"])
    parser.add_argument(
        "--stale",
        action="store_true",
        help="draw results of another configuration or code too, and say so there",
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
    parser.add_argument(
        "--results", type=Path, default=places.RESULTS / "flight", metavar="DIR", help="folder of flights"
    )
    parser.add_argument(
        "--sweeps", type=Path, default=places.RESULTS / "sweeps", metavar="DIR", help="folder of sweeps"
    )
    parser.add_argument("--out", type=Path, default=places.RESULTS / "figures", metavar="DIR", help="where figures go")
    return parser
