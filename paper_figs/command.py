"""Draw figures of finished flights and sweeps as PDF and PNG; missing results are named and their figures left out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from jax_aero import cli, places
from paper_figs import ablation, maps, model_pairs, pairs, runs, scatter, style, sweeps
from paper_figs.figures import FIGURES, SWEEPS

DRAWINGS: Mapping[str, Callable[[sweeps.Sweep], Figure]] = {
    "levels": ablation.draw,
    "curve": ablation.draw,
    "map": maps.draw,
    "scatter": scatter.draw,
    "matrix": model_pairs.draw,
    "pairs": pairs.draw,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    given = _parser().parse_args(arguments)
    known = [*FIGURES, *_sweep_names(given.sweeps)]
    names = known if not given.names or given.names == ["all"] else given.names
    if unknown := [name for name in names if name not in known]:
        print(f"error: no figure `{unknown[0]}`{places.did_you_mean(unknown[0], known)}", file=sys.stderr)
        return cli.REFUSED
    style.use()
    missing = 0
    for name in names:
        expected = len(FIGURES[name].runs) if name in FIGURES else 0
        if given.runs and len(given.runs) != expected:
            print(f"error: {name} shows {expected} runs, not {len(given.runs)}", file=sys.stderr)
            return 2
        try:
            figure, hashes = _draw(name, given)
        except runs.NotDrawn as reason:
            print(f"error: {name}: {reason}", file=sys.stderr)
            missing += 1
            continue
        for path in style.save(figure, _file_name(name, given.runs), given.out, hashes, dark=given.dark):
            print(path)
    hidden = [name for name in names if name in FIGURES and sweeps.is_finished(given.sweeps / name)]
    for name in hidden:
        print(f"error: the sweep {name} is not drawn, since a figure has its name; give it another", file=sys.stderr)
    if missing:
        print(f"{missing} of {len(names)} figures were not drawn", file=sys.stderr)
    return 1 if missing or hidden else 0


def _draw(name: str, given: argparse.Namespace) -> tuple[Figure, dict[str, str]]:
    if name in FIGURES:
        return FIGURES[name].draw_from_results(given.results, given.runs or ())
    sweep = sweeps.load(given.sweeps, name)
    try:
        with mpl.rc_context({"text.parse_math": False}):  # texts come from files, in which $ is an ordinary character
            return DRAWINGS[sweep.document["drawing"]](sweep), sweep.hashes
    except KeyError as missing:
        raise runs.NotDrawn(f"its tables have no {missing}; --overwrite flies it again") from None


def _file_name(name: str, chosen: Sequence[str] | None) -> str:
    """Return the file name of a figure, with a suffix if it shows other results than its own."""
    if not chosen or tuple(chosen) == FIGURES[name].runs:
        return name
    return name + places.addition("--" + "_".join(run.replace("/", "-") for run in chosen))


def _sweep_names(folder: Path) -> Iterator[str]:
    yield from SWEEPS
    finished = {path.parent.name for path in folder.glob("*/cells.parquet")}
    yield from sorted(finished - {*SWEEPS, *FIGURES})


def _parser() -> argparse.ArgumentParser:
    listed = "figures, and the runs that fill them:\n" + "\n".join(
        f"  {name:<18}{entry.shows}; {' '.join(entry.runs) or 'none'}" for name, entry in FIGURES.items()
    )
    parser = cli.Parser("figures", __doc__, epilog=listed)
    named = parser.add_argument("names", nargs="*", metavar="FIGURE", help="figures or sweeps (default: all)")
    cli.complete_with(named, lambda: [*FIGURES, *SWEEPS, "all"])
    parser.add_argument("--dark", action="store_true", help="also write NAME_dark.png, for a dark page")
    parser.add_argument("--runs", nargs="+", metavar="RUN", help="runs that the figure shows, in its order")
    parser.add_argument(
        "--results", type=Path, default=places.RESULTS / "flight", metavar="DIR", help="folder of flights"
    )
    parser.add_argument(
        "--sweeps", type=Path, default=places.RESULTS / "sweeps", metavar="DIR", help="folder of sweeps"
    )
    parser.add_argument("--out", type=Path, default=places.RESULTS / "figures", metavar="DIR", help="where figures go")
    return parser
