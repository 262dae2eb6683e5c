"""Fly sweeps by name: grids, lists, Latin hypercubes and Sobol sequences of perturbed flights.

A sweep goes to `results/sweeps/NAME/`, and its cells are printed if there are at most 100: how many flights ended how,
and the medians of their largest errors. An interrupted one is resumed with the same result to the last byte; a finished
one is only replaced with --overwrite.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from experiments import cluster, study
from experiments.sweep import run, spec, table
from experiments.sweep.design import Design
from jax_aero.base import places
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import exit_status
from jax_aero.cli import Parser

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
        for design in [Design(spec.load(name)) for name in names]:
            folder = run.run(design, workers=given.workers, cluster=ray, out=given.out, overwrite=given.overwrite)
            if len(design.cells) <= MOST_CELLS:
                print(table.listing(read_table(folder / "cells.parquet"), [axis.name for axis in design.spec.axes]))
            flown = f"{design.n_rows} flights in {len(design.cells)} cells"
            print(f"{design.spec.name}: {flown}, {os.path.relpath(folder)}")

    return exit_status(work, interrupted="the same command goes on with the next chunk")


def _parser() -> Parser:
    parser = Parser("sweep", __doc__)
    study.add_choice(parser, "sweeps")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/sweeps)")
    parser.add_argument(
        "--overwrite", action="store_true", help="start from the beginning, and replace an existing result"
    )
    cluster.add_options(parser, "chunks", "threads, or processes of a local cluster")
    return parser
