"""Fly experiments by name and print their outcomes.

A result goes to `results/flight/NAME/`; with --set, the folder's name states the changes, e.g.
`test1--wind.velocity=0_-12_0`, unless --name gives another. With --out DIR it goes to `DIR/NAME/`, whatever was set.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from experiments import flight, overrides, study
from experiments.engines import MODULES
from experiments.table import outcome_table
from jax_aero import cli
from jax_aero.base import places
from jax_aero.base.terminal import exit_status


def main(words: Sequence[str]) -> int:
    """Fly experiments; return the exit status."""
    given = _parser().parse_args(words)
    names = places.names("experiments") if given.all else given.names
    if given.list or not names:
        print("experiments (jax-aero fly NAME):")
        study.print_titles("experiments")
        return 0 if given.list else 2

    def work() -> None:
        changes = overrides.parse([*given.set, *([f"engine={given.engine}"] if given.engine else [])])
        study.check_name(given)
        paths = [study.find("experiments", name) for name in names]
        command = ["jax-aero", "fly", *words]
        options = {"named": given.named, "out": given.out, "overwrite": given.overwrite}
        finished = [flight.run(path, changes, command=command, **options) for path in paths]
        print(outcome_table(finished))

    return exit_status(work, interrupted="the flight under way left nothing behind")


def _parser() -> argparse.ArgumentParser:
    parser = cli.Parser("fly", __doc__)
    study.add_choice(parser, "experiments")
    study.add_set(parser)
    study.add_name(parser)
    parser.add_argument("--engine", choices=sorted(MODULES), help="engine (default: that of the configuration)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/flight)")
    parser.add_argument("--overwrite", action="store_true", help="fly again and replace an existing result")
    return parser
