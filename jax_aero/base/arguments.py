"""Arguments of commands: their parser, kinds of values, and words for Tab completion."""

from __future__ import annotations

import argparse
import itertools
import math
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import argcomplete

from jax_aero.base import places
from jax_aero.base.places import did_you_mean


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


def share(text: str) -> float:
    """Convert an argument of `type=share` to a number from 0 to 1."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 <= number <= 1.0:
        raise argparse.ArgumentTypeError(f"`{text}`; expected a number from 0 to 1")
    return number


def add_name(parser: argparse.ArgumentParser, default: str) -> None:
    """Add `--name`, the name of the result; `default` states what it is otherwise."""
    parser.add_argument("--name", dest="named", type=_name, metavar="NAME", help=f"name of the result ({default})")


def add_results(parser: argparse.ArgumentParser) -> None:
    """Add `--results`, the folder whose folders are those of each kind of result."""
    about = "folder of all results, with flight/ and sweeps/ (default results)"
    parser.add_argument("--results", type=Path, default=places.RESULTS, metavar="DIR", help=about)


def _name(text: str) -> str:
    if not re.fullmatch(places.NAME, text):
        raise argparse.ArgumentTypeError(f"`{text}`; expected a letter or digit, then any characters but /")
    return text


def complete_with(action: argparse.Action, words: Callable[[], Iterable[str]]) -> None:
    """Offer these words for Tab completion of an argument."""
    setattr(action, "completer", lambda **_: words())  # noqa: B010 - an attribute that argcomplete reads
