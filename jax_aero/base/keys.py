"""Dotted keys of configurations, such as `wind.velocity`, and assignments `key=value` of a command line."""

from __future__ import annotations

import copy
import datetime
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from jax_aero.base.terminal import ConfigError, Refused

BARE_WORD = re.compile(r"[A-Za-z_./][\w./-]*")


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Return the values of `key=value` texts by key; values are TOML, with a bare word as a string.

    Raises
    ------
    Refused
        If a text has no `=`, has an empty part of a key, or has a value that is not TOML, is more than one value or
        contains a date; and if a key is given twice.
    """
    values: dict[str, Any] = {}
    for assignment in assignments:
        key, value = _parse_assignment(assignment)
        if key in values:
            raise Refused(f"--set {assignment}: `{key}` is {values[key]!r} already; expected each key once")
        values[key] = value
    return values


def _parse_assignment(assignment: str) -> tuple[str, Any]:
    key, equals, text = (part.strip() for part in assignment.partition("="))
    if not equals or not all(key.split(".")):
        raise Refused(f"--set {assignment}: expected key=value, e.g. wind.velocity=[0,-12,0]")
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError as reason:
        # Shells remove quotes, so `simulator.lever_arm=unrotated` is accepted.
        if BARE_WORD.fullmatch(text) is None:
            raise Refused(f"--set {assignment}: `{text}` is no TOML value ({reason})") from None
        return key, text
    if len(table) > 1:
        raise Refused(f"--set {assignment}: `{text}` is more than a value; expected one")
    for name, part in parts(table["value"], key):
        if isinstance(part, datetime.date | datetime.time):
            wrong = ConfigError.of(name, str(part), "a number, text, list or table, as no key is a date")
            raise wrong.in_file(f"--set {assignment}")
    return key, table["value"]


def get(config: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key, or `None` if the key is missing."""
    value: Any = config
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return None
        value = value[part]
    return value


def parts(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and value of `value` and of everything it contains; list indices are numbers."""
    yield key, value
    if isinstance(value, Mapping):
        entries: Iterable[tuple[Any, Any]] = value.items()
    else:
        entries = enumerate(value) if isinstance(value, list | tuple) else ()
    for name, entry in entries:
        yield from parts(entry, join(key, str(name)))


def join(key: str, name: str) -> str:
    """Return the dotted key of a name in the table at `key`, which is empty for the whole."""
    return f"{key}.{name}" if key else name


def set_key(config: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key in place to a copy of `value`. Missing tables are created; a number is an index into a list.

    Raises
    ------
    ConfigError
        If a part of the key names a value that is not a table, or an index outside its list.
    """
    *parents, last = key.split(".")
    table: Any = config
    for depth, part in enumerate(parents):
        place = _place(table, parents[:depth], part)
        table = table.setdefault(place, {}) if isinstance(table, dict) else table[place]
    table[_place(table, parents, last)] = copy.deepcopy(value)


def replaced(table: Any, key: str, value: Any) -> Any:
    """Return a table in which a dotted key that it has is `value`; only what holds the key is copied."""
    part, _, rest = key.partition(".")
    copied: Any = list(table) if isinstance(table, list) else dict(table)
    place: Any = int(part) if isinstance(table, list) else part
    copied[place] = replaced(copied[place], rest, value) if rest else value
    return copied


def _place(table: Any, parents: list[str], part: str) -> int | str:
    """Return the index of a part of a key in the table or list at `parents`."""
    if isinstance(table, dict):
        return part
    if isinstance(table, list) and part.isdecimal() and int(part) < len(table):
        return int(part)
    raise ConfigError.of(".".join(parents), table, f"a table or list that has `{part}`")
