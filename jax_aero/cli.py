"""The command `jax-aero`, with one sub-command for each function of this project.

`python -m jax_aero COMMAND` does the same.
"""

from __future__ import annotations

import importlib
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from jax_aero.base import checkout
from jax_aero.base.arguments import Parser
from jax_aero.base.terminal import CLOSED as CLOSED
from jax_aero.base.terminal import INTERRUPTED as INTERRUPTED
from jax_aero.base.terminal import REFUSED as REFUSED
from jax_aero.base.terminal import Refused, missing_package, package_of, refuse, run_with_output


class Command(NamedTuple):
    """A command or sub-command."""

    module: str = ""
    """Its module, whose function `main` it is, or that of another name after a colon; none if it has parts alone."""
    needs: str = ""
    """Extras of the package that it needs."""
    about: str = ""
    """What it does; a sub-command says so itself."""


COMMANDS = {
    "fly": Command("jax_aero.commands.fly", "figs", "fly experiments by name: jax-aero fly test2"),
    "sweep": Command("jax_aero.commands.sweep", "sweeps", "fly many perturbed flights, and count"),
    "challenge": Command("jax_aero.commands.challenge", "sweeps", "fly a controller of yours through wind-humanoid-1"),
    "figures": Command("jax_aero.commands.figures", "figs", "draw figures from results"),
    "report": Command(
        "experiments.report.command", "sweeps", "write all results on one page, or keep some in the documentation"
    ),
    "report keep": Command("jax_aero.stored.keep", "sweeps"),
    "view": Command("jax_aero.commands.view:view", "view", "show a flight in the browser, and fly it again"),
    "view video": Command("jax_aero.commands.view:video", "view"),
    "view snapshot": Command("jax_aero.commands.view:snapshot", "view"),
    "export": Command(
        "jax_aero.commands.view:export", "view,logs", "write a flight as HTML, MCAP or CSV for other viewers"
    ),
    "replay": Command("jax_aero.commands.replay", "logs", "replay a log through the tick of a controller, and compare"),
    "identify": Command("jax_aero.commands.identify", "twin,logs", "find a robot's numbers in its own logs"),
    "study": Command("jax_aero.commands.study", "view,symbolic", "answer a question: jax-aero study lists them"),
    "air": Command("jax_aero.commands.air", "twin", "force and moment of robot and links by angle and posture"),
    "verify": Command("jax_aero.commands.verify", "twin", "compare the Rust crate with JAX"),
    "robot": Command(about="make a robot of a URDF, or a mission of waypoints, to fly"),
    "robot import": Command("jax_aero.commands.robot", "twin,symbolic"),
    "robot waypoints": Command("jax_aero.robot.waypoints", "sweeps"),
    "data": Command(about="read logs of a turbine, CFD tables and wind-tunnel files, fit coefficients"),
    "data import-bench": Command("jax_aero.data.import_bench", "twin"),
    "data import-cfd": Command("jax_aero.data.import_cfd", "twin"),
    "data import-tunnel": Command("jax_aero.data.import_tunnel", "twin"),
    "data import-pressures": Command("jax_aero.data.import_pressures", "twin"),
    "data fit-aero": Command("jax_aero.train.fit_aero", "fit"),
    "train": Command(
        "jax_aero.commands.train",
        "train",
        "train an aerodynamic network of CFD or of flights, several of them, or search for its settings",
    ),
    "train ensemble": Command("jax_aero.train.ensemble", "train"),
    "train search": Command("jax_aero.train.search", "train"),
    "train flights": Command("jax_aero.train.from_flights", "train,logs"),
    "cfd": Command(
        "jax_aero.commands.cfd", "twin,sweeps", "compute forces of the air with OpenFOAM, verify and compare them"
    ),
    "cfd verify": Command("jax_aero.cfd.verify", "twin,sweeps"),
    "cfd flow": Command("jax_aero.cfd.flow", "flow"),
    "cfd compare": Command("jax_aero.cfd.compare", "twin,sweeps"),
    "cfd tunnel": Command("jax_aero.cfd.tunnel", "twin,sweeps"),
    "cfd taps": Command("jax_aero.cfd.taps", "twin,sweeps"),
}
"""Commands, each with its parts."""

PARTS = {
    name: [words.removeprefix(f"{name} ") for words in COMMANDS if words.startswith(f"{name} ")]
    for name in COMMANDS
    if " " not in name
}
"""Sub-commands, by command."""


def function_of(command: str) -> Callable[[Sequence[str]], int | None]:
    """Return the function of a command or sub-command; its module is imported here, so that no other waits for it."""
    module, _, name = COMMANDS[command].module.partition(":")
    load = checkout.load if module.startswith("experiments.") else importlib.import_module
    return getattr(load(module), name or "main")  # type: ignore[no-any-return]


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
    if name not in PARTS:
        _parser().parse_args(words)
        print(_help())
        return 0 if words else REFUSED
    if rest and rest[0] in PARTS[name]:
        command = f"{name} {rest.pop(0)}"
    elif COMMANDS[name].module:
        command = name
    else:
        return _choose(name, rest)
    try:
        return function_of(command)(rest) or 0
    except ModuleNotFoundError as missing:
        if package_of(missing) in ("", "jax_aero", "experiments", "paper_figs"):
            raise  # no extra brings a module of ours
        return refuse(missing_package(f"`{name}`", missing, COMMANDS[command].needs))
    except Refused as reason:
        return refuse(str(reason))


def _choose(name: str, words: Sequence[str]) -> int:
    """Refuse a command that does nothing without one of its sub-commands."""
    parser = Parser(name, COMMANDS[name].about)
    parser.add_argument("part", choices=PARTS[name], metavar="COMMAND", help=", ".join(PARTS[name]))
    parser.parse_args(words)
    return REFUSED


def _parser() -> Parser:
    parser = Parser("", None, add_help=False)
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("--version", action="version", version=version("jax-aero"))
    parser.add_argument("command", nargs="?", default="help", choices=[*PARTS, "help"], metavar="COMMAND")
    return parser


def _help() -> str:
    width = max(map(len, PARTS))
    listed = "\n".join(
        f"  {name:<{width}}  {COMMANDS[name].about}" + (f" ({', '.join(parts)})" if parts else "")
        for name, parts in PARTS.items()
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
    has_part = len(words) > 2 and (words[0] == "study" or f"{words[0]} {words[1]}" in COMMANDS)
    os.environ["_ARGCOMPLETE"] = "3" if has_part else "2"
    return words[: 1 + has_part]
