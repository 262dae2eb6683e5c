"""Comparison of the Rust crate with JAX, on the same states and in the same flight, and with the C library.

    jax-aero verify                                    # TEST2: random states, every tick, the flight
    jax-aero verify --config test2_published --set wind.velocity=[0,-12,0]
    jax-aero verify --controller my_controller.toml    # another controller in the same flight
    jax-aero verify --robot my_robot.toml              # another robot: its kinematics and dynamics
    jax-aero verify --config test4                     # the network, in double precision
    jax-aero verify --config robot                     # the recommended controller in the realistic simulation
    jax-aero verify --config engine_out_mpc            # what JAX does not fly to the end: its law
    jax-aero verify --all --quick --set simulator.duration=1   # every shipped flight, and what none of them executes

Prints a table in the end, writes it, and exits with status 1 if anything disagrees. States and ticks are compared
relative to the largest entry of the crate's results, or with its rounding where terms cancel; the flight from its start
by the absolute difference of every logged signal, as far as it can be reproduced. A result of the same files and
options is replaced, that of others only with --overwrite.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.arguments import Parser, complete_with, count
from jax_aero.base.files import read_json, replace_infinite, write_json, write_text
from jax_aero.base.keys import parse_assignments
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.verify import Row, compared, random_samples, use_double_precision, verify_robots

NUMBERS = "verify.json"
"""File of a result with its subject and its numbers."""


def main(arguments: Sequence[str]) -> int:
    """Compare, print and write; return 0 if everything agrees, 1 if not, 2 for invalid arguments."""
    options = _parse(arguments)
    return exit_status(lambda: _compare_all(options) if options.all else _compare(options, set(), []))


def _compare_all(options: argparse.Namespace) -> int:
    """Compare every shipped flight; print what none of them executes.

    A flight that is refused as it is shipped stands in the list of refusals, and is none that fails.
    """
    from jax_aero.verify.lines import unexecuted

    lines: set[tuple[str, int]] = set()
    sides: list[Any] = []
    worst = 0
    for name in places.names("experiments"):
        print(f"\n{name}")
        options.config = name
        status = exit_status(lambda: _compare(options, lines, sides))
        if status and compared(rust.load_config(name)) != "nothing":
            worst = max(worst, status)
    print("\nnot executed by any:\n" + "\n".join(unexecuted(lines, sides)))
    return worst


def _compare(options: argparse.Namespace, lines: set[tuple[str, int]], all_sides: list[Any]) -> int:
    """Compare; add the lines of the model that ran, and the sides that its choices took."""
    import jax

    from jax_aero.refusals import refuse
    from jax_aero.sim.preparation import read_config
    from jax_aero.sim.programs import keep_programs
    from jax_aero.verify.everything import verify_everything
    from jax_aero.verify.flight import verify_flight
    from jax_aero.verify.law import verify_law
    from jax_aero.verify.library import BUILD, find, verify_library, why_not
    from jax_aero.verify.lines import Sides, merged, unexecuted, watch_lines
    from jax_aero.verify.reach import Compared, unreached
    from jax_aero.verify.ticks import verify_held, verify_ticks

    keep_programs()
    config = None if options.robot else use_double_precision(_config(options))
    if config is not None and compared(config) == "nothing":
        refuse(read_config(config))
    folder, facts = _subject(options, config)
    _check_replaceable(folder, facts, overwrite=options.overwrite)
    robot, findings, sides = options.robot if config is None else config["robot"], {}, list[Sides]()
    with jax.enable_x64(True), watch_lines() as ran:
        _say(f"kinematics and dynamics of {options.states} random states")
        rows = verify_robots(robot, options.states, options.dynamics, options.seed)
        if config is not None:
            if compared(config) == "tick":
                _say("every value of ticks from these states")
                samples = random_samples(config, options.states, options.seed)
                rows += verify_ticks(config, samples, sides) + verify_held(config, samples, sides)
                _say("every tick of the flight, then the flight from its start")
                flight = verify_flight(config, options.dynamics)
                _say("two flights in which everything acts; engines, set-points, winds and limits by themselves")
                of_everything, everything = verify_everything()
                rows += flight.rows + of_everything
                flights = [flight.sections, *(of.sections for of in everything)]
                sides += [section.sides for sections in flights for section in sections]
                flown = Compared(flight.scenario, samples, flight.sections)
                findings = {
                    "compared": f"{flight.share:.1%} of the ticks, the flight up to {flight.until:.2f} s",
                    "not reached": ["not examined"] if options.quick else unreached(flown, everything),
                }
            else:
                _say("the law in every tick of the crate's flight")
                of_law, share = verify_law(config)
                rows += of_law
                findings = {
                    "compared": f"{share:.1%} of the ticks, the law alone",
                    "not reached": ["what no tick of this flight reaches, which is not examined"],
                }
            if not options.all:  # programs that another flight has traced would seem not to be executed
                findings["not executed"] = unexecuted(ran, sides)
            lines |= ran
            all_sides.append(merged(sides))
            library, reason = options.library or find(), why_not(config)
            if library is not None and reason is None:
                _say("the C library")
                rows += verify_library(config, library)
            findings["C library"] = f"not compared: {reason}" if reason else str(library or f"not built: {BUILD}")
    print(table(rows))
    written = write(rows, folder, {"crate": rust.__version__, "jax": jax.__version__, **facts, **findings})
    bad = [row for row in rows if not row.agrees]
    but = f", not {', '.join(f'{row.group} {row.quantity}' for row in bad)}" if bad else ""
    shown = {name: f"{len(findings[name])} places, named in {NUMBERS}" for name in findings if name == "not executed"}
    print("\n" + _lines(findings | shown))
    print(f"{len(rows) - len(bad)} of {len(rows)} quantities agree{but}; see {', '.join(map(str, written))}")
    return 1 if bad else 0


def _say(what: str) -> None:
    """Name what is compared next, which takes from seconds to half an hour, beside what is printed in the end."""
    print(f"comparing {what} ...", file=sys.stderr, flush=True)


def _subject(options: argparse.Namespace, config: rust.Config | None) -> tuple[Path, dict[str, Any]]:
    """Return the folder of the result, and what it is a result of."""
    facts = {"backend": options.dynamics, "states": options.states, "seed": options.seed}
    if config is None:
        robot = rust.Robot(options.robot)
        name = places.file_name(robot.name)
        files = hashlib.sha256((robot.toml_text + robot.urdf_text).encode()).hexdigest()
        facts |= {"robot": robot.name, "files": files[:12]}
    else:
        name = Path(options.config).stem
        facts |= {"flight": config["title"] or options.config, "config": rust.config_digest(config)[:12]}
    return options.out or places.RESULTS / "verify" / name, facts


def _check_replaceable(folder: Path, facts: Mapping[str, Any], *, overwrite: bool) -> None:
    """Refuse, without `overwrite`, to replace a result of anything else."""
    path = folder / NUMBERS
    if overwrite or not path.exists():
        return
    with suppress(OSError, ValueError):
        kept = read_json(path)
        if all(kept.get(name) == value for name, value in facts.items()):
            return
    raise Refused(f"{path} is the result of another comparison; choose another --out, or --overwrite it")


def _parse(arguments: Sequence[str]) -> Any:
    parser = Parser("verify", __doc__)
    what = parser.add_mutually_exclusive_group()
    chosen = what.add_argument("--config", default="test2", metavar="NAME", help="flight to compare: name or path")
    complete_with(chosen, lambda: places.names("experiments"))
    what.add_argument("--all", action="store_true", help="every shipped flight, each with its own result")
    what.add_argument("--robot", help="robot file: compare only its kinematics and dynamics")
    parser.add_argument("--controller", metavar="NAME", help="another one, of configs/control, or its file")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change the configuration")
    parser.add_argument("--states", type=count, default=50, help="number of random and of recorded states")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--dynamics", choices=["tree", "mjx"], default="tree", help="implementation of the dynamics")
    parser.add_argument("--quick", action="store_true", help="do not search for numbers that nothing reaches")
    about = "libflight.so to compare (default: the newest that cargo built)"
    parser.add_argument("--library", type=Path, metavar="FILE", help=about)
    parser.add_argument("--out", type=Path, help="folder for the table; default results/verify/NAME")
    parser.add_argument("--overwrite", action="store_true", help="replace the result of another comparison")
    options = parser.parse_args(arguments)
    if options.robot and (options.controller or options.set):
        parser.error("`--robot` compares no flight: expected neither `--controller` nor `--set`")
    if options.all and options.out:
        parser.error("`--all` writes a result for each flight: expected no `--out`")
    return options


def _config(options: argparse.Namespace) -> dict[str, Any]:
    changes = parse_assignments(options.set)
    if options.controller is not None:
        changes = {"controller": rust.load_controller(options.controller), **changes}
    return rust.load_config(options.config, changes)


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    head = f"| {'group':8} | {'quantity':26} | samples | max abs  | max rel  | rounding | tolerance     | verdict   |"
    rule = f"|{'-' * 10}|{'-' * 28}|--------:|---------:|---------:|---------:|---------------|-----------|"
    lines = [
        f"| {row.group:8} | {row.quantity:26} | {row.samples:7} "
        f"| {row.absolute:8.1e} | {row.relative:8.1e} | {row.rounding:8.1e} "
        f"| {row.tolerance:5.0e} {'rel' if row.is_relative else 'abs'}     "
        f"| {'agrees   ' if row.agrees else 'DISAGREES'} |"
        for row in rows
    ]
    return "\n".join([head, rule, *lines])


def _lines(facts: Mapping[str, Any]) -> str:
    return "\n".join(
        f"{name}: {', '.join(value) or 'none' if isinstance(value, list) else value}" for name, value in facts.items()
    )


def write(rows: Sequence[Row], folder: Path, facts: Mapping[str, Any]) -> list[Path]:
    """Write table and numbers; return the paths written."""
    text, numbers = folder / "verify.md", folder / NUMBERS
    write_text(text, f"# Rust against JAX\n\n{_lines(facts)}\n\n{table(rows)}\n")
    entries = [replace_infinite(asdict(row) | {"relative": row.relative, "agrees": row.agrees}) for row in rows]
    write_json(numbers, dict(facts) | {"rows": entries})
    return [text, numbers]
