"""Draw figures from finished flights, as PDF and PNG."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from paper_figs import demo, fig5_flight, runs, style

Draw = Callable[[Path, Sequence[str]], tuple[Figure, dict[str, str]]]

FIGURES: dict[str, tuple[Draw, Sequence[str], str]] = {
    "fig5": (fig5_flight.draw, fig5_flight.RUNS, "Fig. 5 b-i: one envelope flown twice"),
    "demo": (demo.draw, demo.RUNS, "both controllers, right and published lever arms"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    given = _parser().parse_args(arguments)
    unknown = [name for name in given.names if name not in FIGURES]
    if unknown:
        print(f"error: no figure {', '.join(unknown)}; there are {', '.join(FIGURES)}", file=sys.stderr)
        return 2
    style.use()
    missing = False
    for name in given.names or FIGURES:
        draw, default_runs, _ = FIGURES[name]
        names = given.runs or default_runs
        if len(names) != len(default_runs):
            print(f"error: {name} shows {len(default_runs)} runs, not {len(names)}", file=sys.stderr)
            return 2
        try:
            figure, hashes = draw(given.results, names)
        except runs.MissingRun as reason:
            print(f"error: {name}: {reason}", file=sys.stderr)
            missing = True
            continue
        for path in style.save(figure, name, given.out, hashes):
            print(path)
        plt.close(figure)
    return 1 if missing else 0


def _parser() -> argparse.ArgumentParser:
    listed = "; ".join(f"{name}: {about} (runs: {' '.join(shown)})" for name, (_, shown, about) in FIGURES.items())
    parser = argparse.ArgumentParser(prog="python -m paper_figs", description=__doc__, epilog=listed)
    parser.add_argument("names", nargs="*", metavar="FIGURE", help=f"any of {', '.join(FIGURES)} (default all)")
    parser.add_argument("--runs", nargs="+", metavar="RUN", help="which runs fill the figure, in its order")
    parser.add_argument("--results", type=Path, default=runs.default_results(), metavar="DIR", help="where flights lie")
    parser.add_argument("--out", type=Path, default=runs.default_out(), metavar="DIR", help="where figures go")
    return parser


if __name__ == "__main__":
    sys.exit(main())
