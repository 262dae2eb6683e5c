"""Make what the table of the paper judges, then figures and report: `make reproduce`.

A command that fails costs no other: the report says in its rows what failed, and the exit status is 1. It is also 1 if
a verdict is not the kept one (`jax-aero report --check`).
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from experiments.report.paper import commands
from experiments.report.results import FAILED
from jax_aero.base import kinds, places
from jax_aero.base.arguments import Parser
from jax_aero.base.files import write_json
from jax_aero.base.terminal import exit_status
from jax_aero.stored import outdated


def main(arguments: Sequence[str]) -> int:
    """Run the commands; return the exit status."""
    parser = Parser("reproduce", __doc__)
    parser.add_argument("--all", action="store_true", help="our own results too")
    parser.add_argument("--table", type=Path, metavar="FILE", help="the authors' table of their CFD")
    about = "words of commands that are left out: cfd, or the name of a sweep"
    parser.add_argument("--skip", metavar="WORD", nargs="+", default=[], help=about)
    given = parser.parse_args(arguments)

    def work() -> int:
        failed: dict[str, str] = {}
        for line in [*made(given.table), *commands(ours=given.all)]:
            if line.startswith("#") or not {*line.split()}.isdisjoint(given.skip):
                print(f"left out: {line}")
            elif reason := run(line + renewal(line)):
                failed[line] = reason
        write_json(places.RESULTS / FAILED, failed)
        judged = [bool(run(line)) for line in shown(given.table)]
        for line, reason in failed.items():
            print(f"failed: {line}: {reason}", file=sys.stderr)
        return int(bool(failed) or any(judged))

    return exit_status(work, interrupted="the same command makes what is missing")


def _data(table: Path | None) -> tuple[str, Path, str]:
    """Return the name of the data of fits and trainings, their file, and the training."""
    if table:
        return "freestream", places.RESULTS / "datasets/freestream.nc", "compact"
    return "open", places.CONFIGS / "aero/datasets/open.nc", "open"


def made(table: Path | None) -> Iterator[str]:
    """Yield the commands that fit and train force models, and fly the network."""
    data, file, training = _data(table)
    card = shlex.quote(str(places.RESULTS.resolve() / f"training/{training}/{training}.json"))
    if table:
        yield f"jax-aero data import-cfd --table {shlex.quote(str(table))} --out {shlex.quote(str(file))}"
    yield f"jax-aero data fit-aero {data}"
    yield f"jax-aero train {training} --dataset {shlex.quote(str(file))}"
    trained = f"--out results/trained --overwrite --set simulator.aero.card={card}"
    yield f"jax-aero fly test3 {trained}"
    yield f"jax-aero fly test4 {trained} --set controller.aero.card={card}"


def shown(table: Path | None) -> Iterator[str]:
    """Yield the commands that draw and judge."""
    data, _, training = _data(table)
    yield "jax-aero figures all"
    yield f"jax-aero figures fig4_fit --runs {data}"
    yield f"jax-aero figures fig4_network --runs {training}"
    yield "jax-aero report --check"


def renewal(line: str) -> str:
    """Return the option with which a command replaces a result of another identity, if it made one."""
    kind, names = kinds.of_line(line)
    folders = kind.folders(places.RESULTS)
    is_stale = any(outdated.result(kind.name, folder) for folder in folders if folder.name in names or not names)
    return " --overwrite" if is_stale and "--overwrite" not in names else ""


def run(line: str) -> str:
    """Run a command of this project, and show what it says; return the reason if it fails, or else nothing."""
    print(line, flush=True)
    words = shlex.split(line)[1:]
    last = ""
    with subprocess.Popen(
        [sys.executable, "-m", "jax_aero", *words], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        for said in process.stderr or ():
            print(said, end="", file=sys.stderr, flush=True)
            last = said.strip() or last
    return (last or f"status {process.returncode}") if process.returncode else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
