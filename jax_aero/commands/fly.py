"""Fly experiments by name and print their outcomes.

A result goes to `results/flight/NAME/`; with --set, the folder's name states the changes, e.g.
`test1--wind.velocity=0_-12_0`, unless --name gives another. With --out DIR it goes to `DIR/NAME/`, whatever was set.

--row SWEEP N flies one row of a sweep with all its signals, into the folder `SWEEP--row_N`.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.backends import MODULES
from jax_aero.base import arguments, places
from jax_aero.base.keys import parse_assignments
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.results import flight, study
from jax_aero.results.changes import folder_suffix
from jax_aero.results.table import outcome_table


def main(words: Sequence[str]) -> int:
    """Fly experiments; return the exit status."""
    given = _parser().parse_args(words)
    names = places.names("experiments") if given.all else given.names
    if given.list or not (names or given.row):
        print("experiments (jax-aero fly NAME):")
        study.print_titles("experiments")
        return 0 if given.list else 2

    def work() -> None:
        changes = parse_assignments([*given.set, *([f"backend={given.backend}"] if given.backend else [])])
        study.check_name(given)
        if given.named and len(given.controller) > 1:
            raise Refused(f"--name is {given.named}, with {len(given.controller)} controllers; expected one controller")
        paths = [study.find("experiments", name) for name in names]
        command = ["jax-aero", "fly", *words]
        options = {"command": command, "out": given.out, "overwrite": given.overwrite}
        finished = []
        for controller in given.controller or [None]:
            flown = changes | (controller_change(controller) if controller else {})
            suffix = f"{folder_suffix(changes)}--{named(controller)}" if len(given.controller) > 1 else None
            for path in paths:
                name = path.stem + suffix if suffix else given.named
                finished.append(flight.run(path, flown, named=name, **options))
            if given.row:
                name = f"{given.row[0]}--row_{given.row[1]}{suffix}" if suffix else given.named
                finished.append(_fly_row(given.row[0], given.row[1], flown, named=name, **options))
        print(outcome_table(finished))

    return exit_status(work, interrupted="the flight under way left nothing behind")


def controller_change(name: str) -> dict[str, Any]:
    """Return the change of a configuration that flies a controller: FILE.py:NAME, or a file of `configs/control`."""
    if ":" in name:
        return {"own_controller": study.own_controller(name)}
    return {"controller": {"base": str(study.find("control", name).resolve())}}


def named(controller: str) -> str:
    """Return the name of a controller in those of results: of its function or class, or of its file."""
    return controller.rpartition(":")[2] if ":" in controller else Path(controller).stem


def _fly_row(sweep: str, number: str, changes: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    """Fly a row of a sweep as an experiment of its own."""
    from jax_aero.sweep import spec  # its tables need packages that flights do not
    from jax_aero.sweep.design import Design

    design = Design(spec.load(sweep))
    if not number.isdecimal() or int(number) >= design.n_rows:
        raise Refused(f"--row is {number} of {sweep}; expected a number from 0 to {design.n_rows - 1}")
    config = rust.set_keys(design.row_config(int(number)), changes)
    labels = ", ".join(str(level.label) for level in design.cells[design.place(int(number))[0]])
    config["title"] = f"{design.spec.title}: {labels}"
    options["named"] = options["named"] or f"{design.spec.name}--row_{number}{folder_suffix(changes)}"
    options["out"] = options["out"] or places.RESULTS / "flight"
    return flight.run(study.find("sweeps", sweep), changes, config=config, **options)


def _parser() -> argparse.ArgumentParser:
    parser = arguments.Parser("fly", __doc__)
    study.add_choice(parser, "experiments")
    study.add_set(parser)
    study.add_name(parser)
    row = parser.add_argument("--row", nargs=2, metavar=("SWEEP", "N"), help="one row of a sweep")
    arguments.complete_with(row, lambda: places.names("sweeps"))
    controller = parser.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="NAME",
        help="another controller: FILE.py:NAME, a function or class of your own, or a file of configs/control; given "
        "several times, each is flown",
    )
    arguments.complete_with(controller, lambda: places.names("control"))
    parser.add_argument("--backend", choices=sorted(MODULES), help="back end (default: that of the configuration)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/flight)")
    parser.add_argument("--overwrite", action="store_true", help="fly again and replace an existing result")
    return parser
