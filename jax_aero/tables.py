"""TOML files in, typed values out: a `Table` declares keys, types and ranges, and `load` refuses everything else.

A refusal names file, key and value, and says what was expected:

>>> class Wind(Table, frozen=True):
...     speeds: tuple[Positive, ...]
...     is_gusty: bool = False
>>> convert({"speeds": [3.0, -1.0]}, Wind, "wind.toml")
Traceback (most recent call last):
jax_aero.tables.ConfigError: wind.toml: `speeds[1]` is -1.0; expected a number > 0
>>> convert({"speed": [3.0]}, Wind, "wind.toml")
Traceback (most recent call last):
jax_aero.tables.ConfigError: wind.toml: unknown key `speed`; did you mean `speeds`? Known: speeds, is_gusty
"""

from __future__ import annotations

import copy
import difflib
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec

T = TypeVar("T")

MAX_FILE_SIZE = 4 * 1024 * 1024
"""Longest configuration file that is read [bytes]."""

Positive: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0)]
Fraction: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Count: TypeAlias = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
"""A number of things, at least one."""
Natural: TypeAlias = Annotated[int, msgspec.Meta(ge=0)]
"""A number of things, or none."""


class ConfigError(ValueError):
    """A configuration that is refused; the message names file, key and value, and says what was expected."""


class Interval(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Lower and upper end, `[lower, upper]`."""

    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError("Expected `interval`")


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a configuration file: its fields are the keys, nothing else is accepted.

    A field of type `Path` is a file that exists; it stands in the file relative to that file. A `__post_init__` that
    raises `ValueError` refuses combinations of values; its message begins with the field in backticks.
    """


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        if not path.is_file() or path.stat().st_size > MAX_FILE_SIZE:
            raise ConfigError(f"{path.name}: expected a file of at most {MAX_FILE_SIZE} bytes")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as reason:
        raise ConfigError(f"{path.name}: {reason}") from None


def load(path: Path, kind: type[T], changes: Mapping[str, Any] | None = None) -> T:
    """Read a file into its type, with some keys of the outermost table replaced."""
    return convert(read(path) | dict(changes or {}), kind, path.name, path.parent)


def convert(table: Mapping[str, Any], kind: type[T], origin: str, folder: Path = Path()) -> T:
    """Turn a plain table into its type; `origin` names it in refusals, and paths in it start at `folder`."""
    for key, value in _numbers(table):
        if not math.isfinite(value):
            raise ConfigError(f"{origin}: `{key}` is {value}; expected a finite number")
    try:
        return _convert(table, kind, folder)
    except msgspec.ValidationError as refusal:
        raise ConfigError(f"{origin}: {_explain(str(refusal), table, kind, folder)}") from None


def files(config: Any) -> Iterator[Path]:
    """Yield every file that a configuration names."""
    if isinstance(config, Path):
        yield config
    elif isinstance(config, msgspec.Struct | Mapping | tuple | list):
        parts = msgspec.structs.asdict(config).values() if isinstance(config, msgspec.Struct) else config
        for part in parts.values() if isinstance(parts, Mapping) else parts:
            yield from files(part)


def plain(config: Any) -> dict[str, Any]:
    """Return a typed configuration as plain tables, every default written out."""
    table: dict[str, Any] = msgspec.to_builtins(config, enc_hook=str)
    return table


def schema(kind: Any) -> dict[str, Any]:
    """Return the JSON Schema of a type."""
    return msgspec.json.schema(kind, schema_hook=_path_schema)


def _path_schema(_: type) -> dict[str, Any]:
    return {"type": "string", "format": "path"}


def _convert(table: Mapping[str, Any], kind: type[T], folder: Path) -> T:
    def decode(wanted: type, value: Any) -> Any:
        if wanted is Path and isinstance(value, str):
            path = (folder / value).resolve()
            if path.is_file():
                return path
        raise ValueError("Expected `path`")

    return msgspec.convert(table, kind, strict=True, dec_hook=decode)


def _numbers(value: Any, key: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _numbers(entry, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple):
        for index, entry in enumerate(value):
            yield from _numbers(entry, f"{key}[{index}]")
    elif isinstance(value, float):
        yield key, value


# --- refusals ----------------------------------------------------------------------------------------------------

_WORDS = {
    "float": "a number",
    "int": "an integer",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "interval": "two numbers, the lower one first",
    "range": "choices, or low and high, perhaps log",
    "path": "the path of a file that exists, from this one",
}


def _explain(message: str, table: Mapping[str, Any], kind: Any, folder: Path) -> str:
    """Say what msgspec says, with the whole key and the value."""
    text, _, where = message.partition(" - at ")
    key, value, found = _locate(re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", where), text, table, kind, folder)
    if match := re.match(r"Object contains unknown field `(.*)`", text):
        known = [field.encode_name for field in found.fields]
        near = difflib.get_close_matches(match[1], known, 1)
        hint = f"; did you mean `{near[0]}`?" if near else "."
        return f"unknown key `{f'{key}.{match[1]}'.lstrip('.')}`{hint} Known: {', '.join(known)}"
    if match := re.match(r"Object missing required field `(.*)`", text):
        return f"`{f'{key}.{match[1]}'.lstrip('.')}` is missing"
    if match := re.match(r"Expected (.*?)(, got .*)?$", text):
        words = re.sub(r"`(\w+)( \| null)?`", lambda kind: _WORDS.get(kind[1], kind[1]), match[1])
        return f"`{key}` is {value!r}; expected {words.removesuffix('.0')}"
    if text.startswith("Invalid enum value"):
        return f"`{key}` is {value!r}; expected one of {', '.join(map(str, found.values))}"
    if not key:
        return text
    return f"`{key}.{text[1:]}" if text.startswith("`") else f"`{key}`: {text}"


def _locate(
    steps: list[tuple[str, str]], text: str, table: Mapping[str, Any], kind: Any, folder: Path
) -> tuple[str, Any, Any]:
    """Return key, value and type at a place as msgspec writes it; it writes `[...]` for every key of a free table."""
    key = ""
    value: Any = table
    found: Any = msgspec.inspect.type_info(kind)
    for name, index in steps:
        found = _one_of(found)
        if name:
            key, value = f"{key}.{name}".lstrip("."), value[name]
            found = next(field.type for field in found.fields if field.encode_name == name)
        elif index == "...":
            last = next(entry for entry in value if _refuses(text, {entry: value[entry]}, value, table, kind, folder))
            key, value, found = f"{key}.{last}".lstrip("."), value[last], found.value_type
        else:
            key, value = f"{key}[{index}]", value[int(index)]
            items = getattr(found, "item_types", None) or [field.type for field in getattr(found, "fields", ())]
            found = items[int(index)] if items else found.item_type
    return key, value, _one_of(found)


def _one_of(found: Any) -> Any:
    """Return the part of a union with nothing that is not nothing."""
    options = getattr(found, "types", (found,))
    return next((option for option in options if not isinstance(option, msgspec.inspect.NoneType)), found)


def _refuses(text: str, entry: Any, whole: Any, table: Mapping[str, Any], kind: Any, folder: Path) -> bool:
    """Return whether the same refusal comes when a free table holds one entry alone."""
    memo: dict[int, Any] = {id(whole): entry}
    try:
        _convert(copy.deepcopy(dict(table), memo), kind, folder)
    except msgspec.ValidationError as refusal:
        return str(refusal).startswith(text)
    return False
