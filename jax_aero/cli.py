"""The command `jax-aero`, with one sub-command for each function of this project.

`python -m jax_aero COMMAND` does the same.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import argcomplete

from jax_aero.base import places
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import CLOSED as CLOSED
from jax_aero.base.terminal import INTERRUPTED as INTERRUPTED
from jax_aero.base.terminal import REFUSED as REFUSED
from jax_aero.base.terminal import missing_package, package_of, refuse, run_with_output

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
    "train": "train an aerodynamic network, several of them, or search for its settings",
    "cfd": "compute forces of the air with OpenFOAM, verify and compare them",
}
"""What each command does."""

FUNCTIONS = {
    "fly": ("experiments.fly:main", "figs"),
    "sweep": ("experiments.sweep.command:main", "sweeps"),
    "challenge": ("experiments.challenge:main", "sweeps"),
    "figures": ("paper_figs.command:main", "figs"),
    "report": ("experiments.report.command:main", "sweeps"),
    "report keep": ("experiments.report.keep:main", "sweeps"),
    "view": ("jax_aero.view.cli:view", "view"),
    "view video": ("jax_aero.view.cli:video", "view"),
    "view snapshot": ("jax_aero.view.cli:snapshot", "view"),
    "export": ("jax_aero.view.cli:export", "view,logs"),
    "replay": ("experiments.replay:main", "logs"),
    "identify": ("experiments.identify.command:main", "twin,logs"),
    "study": ("experiments.studies:main", "view,symbolic"),
    "air": ("experiments.air:main", "twin"),
    "verify": ("jax_aero.verify.cli:main", "twin"),
    "robot import": ("experiments.robot.command:main", "twin,symbolic"),
    "robot waypoints": ("experiments.robot.waypoints:main", "sweeps"),
    "data import-bench": ("experiments.data.import_bench:main", "twin"),
    "data import-cfd": ("experiments.data.import_cfd:main", "twin"),
    "data import-tunnel": ("experiments.data.import_tunnel:main", "twin"),
    "data import-pressures": ("experiments.data.import_pressures:main", "twin"),
    "data fit-aero": ("experiments.data.fit_aero:main", "fit"),
    "train": ("experiments.training.command:main", "train"),
    "train ensemble": ("experiments.training.ensemble:main", "train"),
    "train search": ("experiments.training.search:main", "train"),
    "cfd": ("experiments.cfd.command:main", "twin,sweeps"),
    "cfd verify": ("experiments.cfd.verify:main", "twin,sweeps"),
    "cfd flow": ("experiments.cfd.flow:main", "flow"),
    "cfd compare": ("experiments.cfd.compare:main", "twin,sweeps"),
    "cfd tunnel": ("experiments.cfd.tunnel:main", "twin,sweeps"),
    "cfd taps": ("experiments.cfd.taps:main", "twin,sweeps"),
}
"""Function of each command and sub-command, and the extras of the package that it needs."""


class Parser(argparse.ArgumentParser):
    """Argument parser of a sub-command that suggests corrections of mistyped words and supports Tab completion."""

    def __init__(self, command: str, about: str | None, **more: Any) -> None:
        super().__init__(
            prog=f"jax-aero {command}".strip(),
            description=about,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            **more,
        )
        self.register("type", Path, _path)
        # No option begins with a digit or is an axis, so these mark values, such as `-90:90:10` and `-x`.
        self._negative_number_matcher = re.compile(r"-(\.?\d|[xyz]$)")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Return the arguments; an argument that cannot be parsed ends the program with status 2."""
        argcomplete.autocomplete(self)
        words = sys.argv[1:] if args is None else list(args)
        options = [option for option in self._option_string_actions if option.startswith("--")]
        # Before parsing, since a mistyped required option would be reported as missing.
        for word in itertools.takewhile(lambda word: word != "--", words):
            name = word.partition("=")[0]
            if name.startswith("--") and not any(option.startswith(name) for option in options):
                self.error(f"`{name}` is not understood{did_you_mean(name, options)}")
        given, unknown = self.parse_known_args(words, namespace)
        if unknown:
            self.error(f"`{unknown[0]}` is not understood")
        return given

    def _print_message(self, message: str, file: Any = None) -> None:
        print(message, end="", file=file or sys.stderr)  # argparse itself ignores a closed pipe

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"`{value}` is unknown{did_you_mean(str(value), action.choices)}")


def _path(text: str) -> Path:
    """Convert an argument of `type=Path`; an empty text is refused, not taken as the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("the path is empty; expected a file or folder")
    return Path(text)


def count(text: str) -> int:
    """Convert an argument of `type=count` to a number of at least one."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"`{text}`; expected an integer ≥ 1")
    return int(text)


def add_name(parser: argparse.ArgumentParser, default: str) -> None:
    """Add `--name`, the name of the result; `default` states what it is otherwise."""
    parser.add_argument("--name", dest="named", type=_name, metavar="NAME", help=f"name of the result ({default})")


def _name(text: str) -> str:
    if not re.fullmatch(places.NAME, text):
        raise argparse.ArgumentTypeError(f"`{text}`; expected a letter or digit, then any characters but /")
    return text


def complete_with(action: argparse.Action, words: Callable[[], Iterable[str]]) -> None:
    """Offer these words for Tab completion of an argument."""
    setattr(action, "completer", lambda **_: words())  # noqa: B010 - an attribute that argcomplete reads


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "_ARGCOMPLETE" in os.environ:
        words = _words_before_cursor()
    return run_with_output(lambda: _run(words))


def _run(words: Sequence[str]) -> int:
    """Run a command. Its module is imported here, so that no other command waits for it."""
    try:
        Path.cwd()
    except FileNotFoundError:
        return refuse("the current folder has been deleted; expected one that is there: cd to another one")
    name, *rest = words or ["help"]
    if name not in COMMANDS:
        _parser().parse_args(words)
        print(_help())
        return 0 if words else REFUSED
    if rest and f"{name} {rest[0]}" in FUNCTIONS:
        function, needed = FUNCTIONS[f"{name} {rest.pop(0)}"]
    elif name in FUNCTIONS:
        function, needed = FUNCTIONS[name]
    else:
        return _choose(name, rest)
    try:
        module, attribute = function.split(":")
        work: Callable[[Sequence[str]], int | None] = getattr(importlib.import_module(module), attribute)
        return work(rest) or 0
    except ModuleNotFoundError as missing:
        if package_of(missing) in ("", "jax_aero", "experiments", "paper_figs"):
            raise  # no extra brings a module of ours
        return refuse(missing_package(f"`{name}`", missing, needed))


def _parts(name: str) -> list[str]:
    """Return the sub-commands of a command."""
    return [part for command, _, part in (words.partition(" ") for words in FUNCTIONS) if command == name and part]


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
  jax-aero figures fig5 --runs test2 test1
  jax-aero COMMAND --help                what a command takes

Results go to results/ of the clone, wherever a command is called, or without a clone of the current folder;
--out names another place.
Exit status: 0 done, 1 something disagrees or is missing, 2 refused, 130 interrupted with Ctrl-C, 141 output closed.
Tab completes after: eval "$(register-python-argcomplete jax-aero)"
"""


def _words_before_cursor() -> list[str]:
    """Return the words that the shell asks to complete, and make argcomplete leave out the command's name."""
    line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
    words = shlex.split(line + "_")[1:]  # the suffix preserves an empty last word
    if len(words) < 2:
        return []
    has_part = len(words) > 2 and (words[0] == "study" or f"{words[0]} {words[1]}" in FUNCTIONS)
    os.environ["_ARGCOMPLETE"] = "3" if has_part else "2"
    return words[: 1 + has_part]
