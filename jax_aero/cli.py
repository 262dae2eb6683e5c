"""The command `jax-aero`, with one sub-command for each function of this project.

`python -m jax_aero COMMAND` does the same.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jax_aero.base import checkout
from jax_aero.base.arguments import Parser
from jax_aero.base.terminal import CLOSED as CLOSED
from jax_aero.base.terminal import INTERRUPTED as INTERRUPTED
from jax_aero.base.terminal import REFUSED as REFUSED
from jax_aero.base.terminal import Refused, missing_package, package_of, refuse, run_with_output

COMMANDS = {
    "fly": "fly experiments by name: jax-aero fly test2",
    "sweep": "fly many perturbed flights, and count",
    "challenge": "fly a controller of yours through wind-humanoid-1",
    "figures": "draw figures from results",
    "report": "write all results on one page, or keep some in the documentation",
    "view": "show a flight in the browser, and fly it again",
    "export": "write a flight as HTML, MCAP or CSV for other viewers",
    "replay": "replay a log through the tick of a controller, and compare",
    "identify": "find a robot's numbers in its own logs",
    "study": "answer a question: jax-aero study lists them",
    "air": "force and moment of robot and links by angle and posture",
    "verify": "compare the Rust crate with JAX",
    "robot": "make a robot of a URDF, or a mission of waypoints, to fly",
    "data": "read logs of a turbine, CFD tables and wind-tunnel files, fit coefficients",
    "train": "train an aerodynamic network of CFD or of flights, several of them, or search for its settings",
    "cfd": "compute forces of the air with OpenFOAM, verify and compare them",
}
"""What each command does."""

NEEDS = {
    "fly": "figs",
    "sweep": "sweeps",
    "challenge": "sweeps",
    "figures": "figs",
    "report": "sweeps",
    "report keep": "sweeps",
    "view": "view",
    "view video": "view",
    "view snapshot": "view",
    "export": "view,logs",
    "replay": "logs",
    "identify": "twin,logs",
    "study": "view,symbolic",
    "air": "twin",
    "verify": "twin",
    "robot import": "twin,symbolic",
    "robot waypoints": "sweeps",
    "data import-bench": "twin",
    "data import-cfd": "twin",
    "data import-tunnel": "twin",
    "data import-pressures": "twin",
    "data fit-aero": "fit",
    "train": "train",
    "train ensemble": "train",
    "train search": "train",
    "train flights": "train,logs",
    "cfd": "twin,sweeps",
    "cfd verify": "twin,sweeps",
    "cfd flow": "flow",
    "cfd compare": "twin,sweeps",
    "cfd tunnel": "twin,sweeps",
    "cfd taps": "twin,sweeps",
}
"""Extras of the package that each command and sub-command needs."""


def function_of(command: str) -> Callable[[Sequence[str]], int | None]:
    """Return the function of a command or sub-command; its module is imported here, so that no other waits for it."""
    module: Any
    match command:
        case "fly":
            from jax_aero.commands import fly as module
        case "sweep":
            from jax_aero.commands import sweep as module
        case "challenge":
            from jax_aero.commands import challenge as module
        case "figures":
            from jax_aero.commands import figures as module
        case "report":
            module = checkout.load("experiments.report.command")
        case "report keep":
            from jax_aero.stored import keep as module
        case "replay":
            from jax_aero.commands import replay as module
        case "identify":
            from jax_aero.commands import identify as module
        case "study":
            from jax_aero.commands import study as module
        case "air":
            from jax_aero.commands import air as module
        case "verify":
            from jax_aero.commands import verify as module
        case "robot import":
            from jax_aero.commands import robot as module
        case "robot waypoints":
            from jax_aero.robot import waypoints as module
        case "data import-bench":
            from jax_aero.data import import_bench as module
        case "data import-cfd":
            from jax_aero.data import import_cfd as module
        case "data import-tunnel":
            from jax_aero.data import import_tunnel as module
        case "data import-pressures":
            from jax_aero.data import import_pressures as module
        case "data fit-aero":
            from jax_aero.train import fit_aero as module
        case "train":
            from jax_aero.commands import train as module
        case "train ensemble":
            from jax_aero.train import ensemble as module
        case "train search":
            from jax_aero.train import search as module
        case "train flights":
            from jax_aero.train import from_flights as module
        case "cfd":
            from jax_aero.commands import cfd as module
        case "cfd verify":
            from jax_aero.cfd import verify as module
        case "cfd flow":
            from jax_aero.cfd import flow as module
        case "cfd compare":
            from jax_aero.cfd import compare as module
        case "cfd tunnel":
            from jax_aero.cfd import tunnel as module
        case "cfd taps":
            from jax_aero.cfd import taps as module
        case "view" | "view video" | "view snapshot" | "export":
            from jax_aero.commands import view

            return getattr(view, command.split()[-1])  # type: ignore[no-any-return]
        case _:
            raise KeyError(command)
    return module.main  # type: ignore[no-any-return]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "_ARGCOMPLETE" in os.environ:
        words = _words_before_cursor()
    return run_with_output(lambda: _run(words))


def _run(words: Sequence[str]) -> int:
    """Run a command."""
    try:
        Path.cwd()
    except FileNotFoundError:
        return refuse("the current folder has been deleted; expected one that is there: cd to another one")
    name, *rest = words or ["help"]
    if name not in COMMANDS:
        _parser().parse_args(words)
        print(_help())
        return 0 if words else REFUSED
    if rest and f"{name} {rest[0]}" in NEEDS:
        command = f"{name} {rest.pop(0)}"
    elif name in NEEDS:
        command = name
    else:
        return _choose(name, rest)
    try:
        return function_of(command)(rest) or 0
    except ModuleNotFoundError as missing:
        if package_of(missing) in ("", "jax_aero", "experiments", "paper_figs"):
            raise  # no extra brings a module of ours
        return refuse(missing_package(f"`{name}`", missing, NEEDS[command]))
    except Refused as reason:
        return refuse(str(reason))


def _parts(name: str) -> list[str]:
    """Return the sub-commands of a command."""
    return [part for command, _, part in (words.partition(" ") for words in NEEDS) if command == name and part]


def _choose(name: str, words: Sequence[str]) -> int:
    """Refuse a command that does nothing without one of its sub-commands."""
    parser = Parser(name, COMMANDS[name])
    parser.add_argument("part", choices=_parts(name), metavar="COMMAND", help=", ".join(_parts(name)))
    parser.parse_args(words)
    return REFUSED


def _parser() -> Parser:
    parser = Parser("", None, add_help=False)
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("--version", action="version", version=version("jax-aero"))
    parser.add_argument("command", nargs="?", default="help", choices=[*COMMANDS, "help"], metavar="COMMAND")
    return parser


def _help() -> str:
    width = max(map(len, COMMANDS))
    listed = "\n".join(
        f"  {name:<{width}}  {about}" + (f" ({', '.join(_parts(name))})" if _parts(name) else "")
        for name, about in COMMANDS.items()
    )
    return f"""usage: jax-aero COMMAND ...

Flight of a jet-powered humanoid robot in the wind: physics, control, experiments and figures.

{listed}

first steps:
  jax-aero fly --list                    what there is to fly
  jax-aero fly test1 test2               fly it: how it ended, and a folder with every signal
  jax-aero fly test1 --set wind.velocity=[0,-12,0]
  jax-aero figures compare --runs test1 test2
  jax-aero COMMAND --help                what a command takes

Results go to results/ of the clone, wherever a command is called, or without a clone of the current folder;
--out names another place.
Exit status: 0 done, 1 something disagrees or is missing, 2 refused, 130 interrupted with Ctrl-C, 141 output closed.
Tab completes after: eval "$(register-python-argcomplete jax-aero)"
"""


def _words_before_cursor() -> list[str]:
    """Return the words to be completed, and make argcomplete leave out the command's name."""
    line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
    words = shlex.split(line + "_")[1:]  # the suffix preserves an empty last word
    if len(words) < 2:
        return []
    has_part = len(words) > 2 and (words[0] == "study" or f"{words[0]} {words[1]}" in NEEDS)
    os.environ["_ARGCOMPLETE"] = "3" if has_part else "2"
    return words[: 1 + has_part]
