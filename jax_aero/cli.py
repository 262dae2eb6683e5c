"""The command `jax-aero`, with one sub-command for each function of this project.

`python -m jax_aero COMMAND` does the same; `python -m experiments` and `python -m paper_figs` call it too.
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
from typing import Any, NamedTuple

import argcomplete

from jax_aero.command import INTERRUPTED as INTERRUPTED
from jax_aero.command import REFUSED as REFUSED
from jax_aero.command import one_line
from jax_aero.places import did_you_mean

CLOSED = 141


class Command(NamedTuple):
    """A sub-command: the module of its function, the extras of the package that it needs, and its description."""

    function: str
    extras: str
    about: str


GROUPS: dict[str, dict[str, Command]] = {
    "fly and look": {
        "fly": Command("experiments.__main__:fly", "figs", "fly experiments by name: jax-aero fly test2"),
        "waypoints": Command("experiments.waypoints:main", "figs", "make a mission of waypoints, to fly"),
        "sweep": Command("experiments.sweep.command:main", "sweeps", "fly many perturbed flights, and count"),
        "figures": Command("paper_figs.__main__:main", "figs", "draw figures from results"),
        "report": Command("experiments.report.command:main", "sweeps", "write all results on one page"),
        "along": Command("experiments.along:main", "symbolic", "find fuel and clearance along flights"),
        "arm-engines": Command("experiments.arm_engines:main", "figs", "fly with other engines in the arms"),
        "pictures": Command("experiments.pictures:main", "view,symbolic", "draw the robot for figures of the paper"),
        "view": Command("jax_aero.view.command:view", "view", "show a flight in the browser, and fly it again"),
        "video": Command("jax_aero.view.command:video", "view", "film a flight, or two in one scene"),
        "export": Command("jax_aero.view.command:export", "view", "write a flight as one HTML file that plays it"),
        "snapshot": Command("jax_aero.view.command:snapshot", "view", "draw moments of a flight"),
    },
    "understand": {
        "air": Command("experiments.air:main", "twin", "force and moment of robot and links by angle and posture"),
        "verify": Command("jax_aero.verify.command:main", "twin", "compare the Rust crate with JAX"),
        "trim": Command("experiments.trim:main", "symbolic", "find hovering trims by wind"),
        "trajectory": Command("experiments.trajectory:main", "symbolic", "plan optimal trajectories"),
        "force-rate": Command("experiments.force_rate:main", "twin,symbolic", "measure the aerodynamic force's rate"),
        "observer-limit": Command("experiments.observer_limit:main", "twin,symbolic", "bound the observer's gain"),
        "inner-loop": Command("experiments.inner_loop:main", "twin", "find how late measurements may be"),
        "wind-observer": Command("experiments.wind_observer:main", "twin", "measure how well the wind is known"),
        "tip-over": Command("experiments.tip_over:main", "twin", "find the wind that tips the standing robot over"),
        "tunnel-moments": Command("experiments.tunnel_moments:main", "twin", "compare moments with the wind tunnel"),
        "engine-choice": Command("experiments.engine_choice:main", "symbolic", "compare battery and fuel"),
    },
    "build models": {
        "import-robot": Command(
            "experiments.import_robot.command:main", "twin,symbolic", "make a robot that flies of a URDF"
        ),
        "cfd": Command("experiments.cfd.command:main", "twin", "compute forces of the air with OpenFOAM"),
        "cfd-verify": Command("experiments.cfd.verify:main", "twin", "verify OpenFOAM on bodies of known drag"),
        "cfd-flow": Command("experiments.cfd.flow:main", "flow", "keep a flow by OpenFOAM for pictures"),
        "cfd-compare": Command("experiments.cfd.compare:main", "twin", "compare our CFD with tables and the tunnel"),
        "cfd-tunnel": Command("experiments.cfd.tunnel:main", "twin", "compare our CFD with wind-tunnel points"),
        "import-cfd": Command("experiments.import_cfd:main", "twin", "read CFD tables into a data set"),
        "import-tunnel": Command("experiments.import_tunnel:main", "twin", "read wind-tunnel balance files"),
        "identify-aero": Command("experiments.identify_aero:main", "twin", "find coefficients in a flight's log"),
        "identify-engine": Command("experiments.identify_engine:main", "twin", "find an engine in a bench's log"),
        "fit-aero": Command("experiments.fit_aero:main", "fit", "fit coefficients to a data set"),
        "tune": Command("experiments.tune:main", "twin", "improve a controller's gains and weights by gradients"),
        "train": Command("experiments.training.command:main", "train", "train an aerodynamic network"),
        "train-ensemble": Command("experiments.training.ensemble:main", "train", "train networks with intervals"),
        "train-search": Command("experiments.training.search:main", "train", "search for a network's settings"),
        "schema": Command(
            "experiments.schema:main", "train,symbolic", "write what follows from the configuration's types"
        ),
    },
}

COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}


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


def complete_with(action: argparse.Action, words: Callable[[], Iterable[str]]) -> None:
    """Offer these words for Tab completion of an argument."""
    setattr(action, "completer", lambda **_: words())  # noqa: B010 - an attribute that argcomplete reads


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if "_ARGCOMPLETE" in os.environ:
        words = _words_before_cursor()
    name = words[0].replace("_", "-") if words else "help"
    if name in COMMANDS:
        return run(name, words[1:])
    _parser().parse_args(words)
    print(_help())
    return 0 if words else REFUSED


def run(name: str, words: Sequence[str]) -> int:
    """Run one sub-command. Its module is imported here, so that no other command waits for it."""
    try:
        module, function = COMMANDS[name].function.split(":")
        work: Callable[[Sequence[str]], int | None] = getattr(importlib.import_module(module), function)
        return work(words) or 0
    except ModuleNotFoundError as missing:
        package = (missing.name or "").split(".")[0]
        if package in ("", "jax_aero", "experiments", "paper_figs"):
            raise
        return _refuse(f"`{name}` needs the package `{package}`: pip install 'jax-aero[{COMMANDS[name].extras}]'")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # as with `| head`; no more output is possible
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CLOSED
    except OSError as reason:  # such as a full disk or a read-only folder
        return _refuse(one_line(reason))


def _refuse(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
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
        f"\n{title}:\n" + "\n".join(f"  {name:<{width}}  {command.about}" for name, command in group.items())
        for title, group in GROUPS.items()
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

Exit status: 0 done, 1 something disagrees or is missing, 2 refused, 130 interrupted with Ctrl-C.
Tab completes after: eval "$(register-python-argcomplete jax-aero)"
"""


def _words_before_cursor() -> list[str]:
    """Return the words that the shell asks to complete, and make argcomplete leave out the command's name."""
    line = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])]
    words = shlex.split(line + "_")[1:]  # the suffix preserves an empty last word
    if len(words) < 2:
        return []
    os.environ["_ARGCOMPLETE"] = "2"
    return words[:1]
