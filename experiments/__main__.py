"""Run flights by name and say how they ended.

Other commands, each explained by `python -m experiments COMMAND --help`: `sweep` (many perturbed flights), `report`
(all results on one page), `trim`, `trajectory`, `force-rate`, `observer-limit`, `tip-over`, `engine-choice` (battery
against fuel), `import-robot` (from a URDF to a robot that flies), `identify-aero` (coefficients from a flight's log),
`import-cfd`, `fit-aero`, `calibrate-surrogate`, `surrogate-dataset` (data to learn from), `train` and `train-search`
(networks), `schema` (what follows from the types of the configuration).

A result goes to `results/flight/NAME/`; with --set, the folder's name states the changes, e.g.
`test1--wind.velocity=0_-12_0`. With --out DIR it goes to `DIR/NAME/`, whatever was set.
"""

from __future__ import annotations

import argparse
import importlib
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from experiments import Refused, flight, manifest, overrides
from experiments.engines import ENGINES
from experiments.table import outcome_table

INTERRUPTED = 130

COMMANDS = {
    "sweep": "experiments.sweep.command",
    "report": "experiments.report.command",
    "engine-choice": "experiments.engine_choice",
    "trim": "experiments.trim",
    "trajectory": "experiments.trajectory",
    "force-rate": "experiments.force_rate",
    "observer-limit": "experiments.observer_limit",
    "tip-over": "experiments.tip_over",
    "identify-aero": "experiments.identify_aero",
    "import-robot": "experiments.import_robot.command",
    "import-cfd": "experiments.import_cfd",
    "fit-aero": "experiments.fit_aero",
    "calibrate-surrogate": "experiments.calibrate_surrogate",
    "surrogate-dataset": "experiments.surrogate_dataset",
    "train": "experiments.training.command",
    "schema": "experiments.schema",
    "train-search": "experiments.training.search",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and (name := words[0].replace("_", "-")) in COMMANDS:
        # Imported on demand: a single flight needs none of their dependencies.
        run_command: Callable[[Sequence[str]], int] = importlib.import_module(COMMANDS[name]).main
        return run_command(words[1:])
    given = _parser().parse_args(words)
    names = [name for name, _ in flight.available()] if given.all else given.names
    if given.list or not names:
        _print_list()
        return 0 if given.list else 2
    try:
        changes = overrides.parse([*given.set, *([f"engine={given.engine}"] if given.engine else [])])
        paths = [flight.find(name) for name in names]
        command = _command(given)
        finished = [
            flight.run(path, changes, command=command, out=given.out, overwrite=given.overwrite) for path in paths
        ]
    except Refused as reason:
        print(f"error: {reason}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; the flight under way left nothing behind", file=sys.stderr)
        return INTERRUPTED
    print(outcome_table(finished))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m experiments", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="a file stem in configs/experiments, or a path")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change one key of the configuration; the value as in TOML, e.g. wind.velocity=[0,-12,0]",
    )
    parser.add_argument("--all", action="store_true", help="every experiment of configs/experiments")
    parser.add_argument("--engine", choices=sorted(ENGINES), help="engine (default: that of the configuration)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/flight)")
    parser.add_argument("--overwrite", action="store_true", help="fly again and replace a result that is there")
    parser.add_argument("--list", action="store_true", help="list the experiments and stop")
    return parser


def _print_list() -> None:
    entries = list(flight.available())
    width = max((len(name) for name, _ in entries), default=0)
    print("experiments (python -m experiments NAME):")
    for name, title in entries:
        print(f"  {name:<{width}}  {title}")


def _command(given: argparse.Namespace) -> str:
    """Return the command line as it could be typed on another machine."""
    words: list[Any] = [*given.names, *(["--all"] if given.all else [])]
    for assignment in given.set:
        key, _, value = assignment.partition("=")
        words += ["--set", f"{key}={manifest.portable(value)}"]
    words += ["--engine", given.engine] if given.engine else []
    words += ["--out", given.out] if given.out else []
    words += ["--overwrite"] if given.overwrite else []
    return shlex.join(["python", "-m", "experiments", *(str(manifest.portable(word)) for word in words)])


if __name__ == "__main__":
    sys.exit(main())
