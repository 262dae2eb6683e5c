"""Fly sweeps by name: grids, lists, Latin hypercubes and Sobol sequences of perturbed flights.

A sweep goes to `results/sweeps/NAME/`, and its cells are printed if there are at most 100: how many flights ended how,
and their largest errors, with intervals. An interrupted one is resumed with the same result to the last byte; with more
repeats a finished one is continued. It is only replaced with --overwrite.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

from jax_aero.base import places
from jax_aero.base.arguments import Parser
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import exit_status
from jax_aero.results import study
from jax_aero.results.table import FORMATS, Rows
from jax_aero.sweep import cluster, listing, run, spec
from jax_aero.sweep.design import Design
from jax_aero.sweep.paired import differences

MOST_CELLS = 100
"""Greatest number of cells that are printed."""


def main(arguments: Sequence[str]) -> int:
    """Run the command line; return its exit status."""
    given = _parser().parse_args(arguments)
    names = places.names("sweeps") if given.all else given.names
    if given.list or not names:
        study.print_titles("sweeps")
        return 0 if given.list else 2

    def work() -> None:
        ray = cluster.Ray.from_options(given)
        for design in [Design(spec.load(name), study.find("sweeps", name)) for name in names]:
            notes = sys.stderr if given.format else sys.stdout
            with redirect_stdout(notes):
                folder = run.run(design, workers=given.workers, cluster=ray, out=given.out, overwrite=given.overwrite)
            if given.paired or given.format or len(design.cells) <= MOST_CELLS:
                print(FORMATS[given.format or "text"](_rows(folder, design, given.paired)))
            flown = f"{design.n_rows} flights in {len(design.cells)} cells"
            print(f"{design.spec.name}: {flown}, {os.path.relpath(folder)}", file=notes)

    return exit_status(work, interrupted="the same command goes on with the next chunk")


def _rows(folder: Path, design: Design, axis: str | None) -> Rows:
    """Return the rows of the printed table: a cell each, or the differences between levels of an axis."""
    labels = {one.name: f"{one.label or one.name}{one.unit and f' [{one.unit}]'}" for one in design.spec.axes}
    table = read_table(folder / ("table.parquet" if axis else "cells.parquet")).to_pandas(use_threads=False)
    return listing.of_pairs(differences(table, list(labels), axis), labels) if axis else listing.of_cells(table, labels)


def _parser() -> Parser:
    parser = Parser("sweep", __doc__)
    study.add_choice(parser, "sweeps")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/sweeps)")
    parser.add_argument(
        "--overwrite", action="store_true", help="start from the beginning, and replace an existing result"
    )
    parser.add_argument(
        "--format", choices=sorted(FORMATS), help="print the table alone, in this format (default: text)"
    )
    parser.add_argument(
        "--paired", metavar="AXIS", help="print the differences of an axis' levels to the first one, on the same draws"
    )
    cluster.add_options(parser)
    return parser
