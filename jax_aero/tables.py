"""Typed values from TOML files of studies: a `Table` declares keys, types and ranges; `load` refuses everything else.

Flights and robots are read by the crate (`jax_aero.rust`), whose errors have the same form.

A refusal names file, key and value, and what was expected:

>>> class Wind(Table, frozen=True):
...     speeds: tuple[Positive, ...]
...     is_gusty: bool = False
>>> convert({"speeds": [3.0, -1.0]}, Wind, "wind.toml")
Traceback (most recent call last):
jax_aero.command.ConfigError: wind.toml: `speeds[1]` is -1.0; expected a number > 0
>>> convert({"speed": [3.0]}, Wind, "wind.toml")
Traceback (most recent call last):
jax_aero.command.ConfigError: wind.toml: unknown key `speed`; did you mean `speeds`? (known: speeds, is_gusty)
"""

from __future__ import annotations

import difflib
import json
import math
import operator
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from os import PathLike, fspath
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
from msgspec import inspect

from jax_aero.command import ConfigError
from jax_aero.files import check_depth, read_text
from jax_aero.keys import refuse_dates, set_key

T = TypeVar("T")

MAX_FILE_SIZE = 4 * 1024 * 1024
"""Greatest size of a configuration file [bytes]."""

LARGEST = 1e9
"""Greatest magnitude of a number, as in the crate's schema."""

Positive: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0)]
Fraction: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Count: TypeAlias = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
"""A number of items, at least one."""
Natural: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]
"""A number of items, possibly zero."""
Seed: TypeAlias = Annotated[int, msgspec.Meta(ge=0)]
"""A number that random numbers follow from."""


class Interval(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Lower and upper end, `[lower, upper]`."""

    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ConfigError.of("", [self.lower, self.upper], "two numbers, the lower one first")

    @property
    def radians(self) -> tuple[float, float]:
        """Return both ends of an interval of angles given in degrees [rad]."""
        return math.radians(self.lower), math.radians(self.upper)


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a configuration file: its fields are the only accepted keys.

    A field of type `Path` is an existing file, given relative to the configuration file. `__post_init__` may refuse
    combinations of values by `ConfigError.of`, with the name of a field, or none for the whole table.
    """


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        table = tomllib.loads(read_text(path, MAX_FILE_SIZE))
        check_depth(table)
    except (OSError, RecursionError, ValueError) as reason:
        raise ConfigError(f"{path.name}: {reason}") from None
    refuse_dates(table, path.name)
    return table


def load(path: Path, kind: type[T], changes: Mapping[str, Any] | None = None) -> T:
    """Read a file into its type, with some dotted keys replaced."""
    table = read(path)
    for key, value in (changes or {}).items():
        set_key(table, key, value)
    return convert(table, kind, path.name, path.parent)


def convert(table: Mapping[str, Any], kind: type[T], origin: str, folder: Path = Path()) -> T:
    """Convert a plain table to its type; `origin` names it in refusals, and its paths are relative to `folder`."""
    try:
        built: T = _build(table, inspect.type_info(kind), "", folder)
    except ConfigError as refusal:
        raise refusal.in_file(origin) from None
    return built


def files(config: Any) -> Iterator[Path]:
    """Yield every file named in a configuration."""
    if isinstance(config, Path):
        yield config
    elif isinstance(config, msgspec.Struct | Mapping | tuple | list):
        parts = msgspec.structs.asdict(config).values() if isinstance(config, msgspec.Struct) else config
        for part in parts.values() if isinstance(parts, Mapping) else parts:
            yield from files(part)


def check_levels(table: Table, *names: str) -> None:
    """Refuse keys with an empty list or repeated values, since results are named by the values."""
    for name in names:
        if not (values := getattr(table, name)) or len(set(values)) < len(values):
            raise ConfigError.of(name, values, "one value or more, each once")


def to_builtins(config: Any) -> Any:
    """Return a copy of a configuration as a file would hold it.

    Types become tables, every default written out; arrays, NumPy's numbers and paths become lists, numbers and texts.
    """
    return msgspec.to_builtins(config, enc_hook=_to_builtin)


def to_table(config: Table) -> dict[str, Any]:
    """Return what a file of this configuration would hold: as `to_builtins`, without the keys that have no value."""

    def drop_absent(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [drop_absent(item) for item in value]
        if isinstance(value, dict):
            return {key: drop_absent(item) for key, item in value.items() if item is not None}
        return value

    found: dict[str, Any] = drop_absent(to_builtins(config))
    return found


def _to_builtin(value: Any) -> Any:
    if isinstance(value, PathLike):
        return fspath(value)
    if hasattr(type(value), "tolist"):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise ConfigError(f"{value!r} is a {type(value).__name__}; expected a number, text, list or table")


def toml(table: Mapping[str, Any], section: str = "") -> str:
    """Return a table as TOML: numbers, strings, booleans, lists of these, tables as sections; no lists of tables."""
    own = [f"{toml_key(key)} = {toml_value(value)}" for key, value in table.items() if not isinstance(value, Mapping)]
    head = [f"[{section}]"] if section and (own or not table) else []
    inner = [toml(value, _join(section, toml_key(key))) for key, value in table.items() if isinstance(value, Mapping)]
    return "\n\n".join(filter(None, ["\n".join(head + own), *inner]))


def toml_key(name: str) -> str:
    """Return a key as TOML, quoted if necessary."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)


def toml_value(value: Any) -> str:
    """Return a number, string, boolean, or a list or table of these as TOML in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_key(key)} = {toml_value(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(entry) for entry in value) + "]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def schema(kind: Any) -> dict[str, Any]:
    """Return the JSON Schema of a type."""
    return msgspec.json.schema(kind, schema_hook=_path_schema)


def _path_schema(_: type) -> dict[str, Any]:
    return {"type": "string", "format": "path"}


# --- conversion of plain values to their types ---------------------------------------------------------------------


def _build(value: Any, kind: inspect.Type, key: str, folder: Path) -> Any:
    """Return a value converted to its type; `key` is its place."""
    match kind:
        case inspect.UnionType():
            return _build_one_of(value, kind.types, key, folder)
        case inspect.StructType(array_like=False):
            return _build_table(value, kind, key, folder)
        case inspect.StructType() if isinstance(value, list | tuple) and len(value) == len(kind.fields):
            pairs = zip(kind.fields, value, strict=True)
            parts = {field.name: _build(part, field.type, key, folder) for field, part in pairs}
            return _build_checked(kind.cls, parts, key, value)
        case inspect.DictType() if isinstance(value, Mapping):
            return {name: _build(entry, kind.value_type, _join(key, name), folder) for name, entry in value.items()}
        case inspect.TupleType() if isinstance(value, list | tuple) and len(value) == len(kind.item_types):
            items = enumerate(zip(value, kind.item_types, strict=True))
            return tuple(_build(item, each, f"{key}[{index}]", folder) for index, (item, each) in items)
        case inspect.VarTupleType() if isinstance(value, list | tuple) and _has_length(value, kind):
            return tuple(_build(item, kind.item_type, f"{key}[{index}]", folder) for index, item in enumerate(value))
        case inspect.LiteralType() if value in kind.values:
            return value
        case inspect.BoolType() if isinstance(value, bool):
            return value
        case inspect.IntType() if isinstance(value, int) and not isinstance(value, bool) and _is_in_range(value, kind):
            return value
        case inspect.FloatType() if _is_number(value):
            if _is_finite(value) and _is_in_range(value, kind) and abs(value) <= LARGEST:
                return float(value)
        case inspect.StrType() if isinstance(value, str) and (not kind.pattern or re.fullmatch(kind.pattern, value)):
            return value
        case inspect.CustomType() if isinstance(value, str | Path):
            with suppress(OSError):  # not a possible file name
                path = (folder / value).resolve()
                if path.is_file():
                    return path
        case inspect.AnyType():
            return value
    raise ConfigError.of(key, value, _expectation(kind, value))


def _build_one_of(value: Any, options: Sequence[inspect.Type], key: str, folder: Path) -> Any:
    # A key without a value is left out, so `null` is not accepted.
    there = [option for option in options if not isinstance(option, inspect.NoneType)]
    tagged = {option.tag: option for option in there if isinstance(option, inspect.StructType) and option.tag_field}
    if not tagged:
        for option in there[:-1]:
            with suppress(ConfigError):
                return _build(value, option, key, folder)
        return _build(value, there[-1], key, folder)
    if not isinstance(value, Mapping):
        raise ConfigError.of(key, value, "a table")
    tag = next(str(option.tag_field) for option in tagged.values())
    if tag not in value:
        raise _missing(_join(key, tag))
    if not isinstance(value[tag], str) or value[tag] not in tagged:
        raise ConfigError.of(_join(key, tag), value[tag], f"one of {', '.join(map(str, tagged))}")
    return _build_table({name: entry for name, entry in value.items() if name != tag}, tagged[value[tag]], key, folder)


def _build_table(value: Any, kind: inspect.StructType, key: str, folder: Path) -> Any:
    if not isinstance(value, Mapping):
        raise ConfigError.of(key, value, "a table")
    known = {field.encode_name: field for field in kind.fields}
    built = {}
    for name, entry in value.items():
        if name not in known:
            raise _unknown(
                _join(key, name), [_join(key, near) for near in difflib.get_close_matches(name, known, 1)], known
            )
        built[known[name].name] = _build(entry, known[name].type, _join(key, name), folder)
    for name, field in known.items():
        if field.required and name not in value:
            raise _missing(_join(key, name))
    return _build_checked(kind.cls, built, key, value)


def _build_checked(cls: type, parts: dict[str, Any], key: str, value: Any) -> Any:
    """Return the table of these values; a refusal of its own check is reported below `key`."""
    try:
        return cls(**parts)
    except ConfigError as reason:
        raise reason.in_table(key, value) from None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


LIMITS = {"ge": ("≥", operator.ge), "gt": (">", operator.gt), "le": ("≤", operator.le), "lt": ("<", operator.lt)}


def _is_finite(value: float) -> bool:
    # Also for integers too large for a float.
    return abs(value) <= sys.float_info.max


def _is_in_range(value: float, kind: inspect.IntType | inspect.FloatType) -> bool:
    given = [(accepts, getattr(kind, name)) for name, (_, accepts) in LIMITS.items()]
    return all(limit is None or accepts(value, limit) for accepts, limit in given)


def _has_length(value: Sequence[Any], kind: inspect.VarTupleType) -> bool:
    return (kind.min_length or 0) <= len(value) <= (math.inf if kind.max_length is None else kind.max_length)


def _expectation(kind: inspect.Type, value: Any) -> str:
    """Return a description of the values that a type accepts."""
    match kind:
        case inspect.IntType() | inspect.FloatType():
            words = "an integer" if isinstance(kind, inspect.IntType) else "a number"
            if isinstance(value, int | float) and not _is_finite(value):
                return "a finite number"
            if isinstance(kind, inspect.FloatType) and _is_number(value) and _is_in_range(value, kind):
                return "a number from -1e9 to 1e9"
            given = [(sign, getattr(kind, name)) for name, (sign, _) in LIMITS.items()]
            limits = " and ".join(f"{sign} {limit:.9g}" for sign, limit in given if limit is not None)
            return f"{words} {limits}".rstrip()
        case inspect.TupleType():
            return f"a list of {len(kind.item_types)}"
        case inspect.VarTupleType():
            if kind.max_length is not None:
                return f"a list of {kind.min_length or 0} to {kind.max_length}"
            return f"a list of {kind.min_length} or more" if kind.min_length else "a list"
        case inspect.StructType():
            return f"a list of {len(kind.fields)}"
        case inspect.LiteralType():
            return f"one of {', '.join(map(str, kind.values))}"
        case inspect.BoolType():
            return "true or false"
        case inspect.StrType():
            return f"a text that matches {kind.pattern}" if kind.pattern else "a text"
        case inspect.CustomType():
            return "the path of a file" + (" that exists, from this one" if isinstance(value, str) else "")
    return "a table"


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _missing(key: str) -> ConfigError:
    return ConfigError(f"`{key}` is missing", key=key)


def _unknown(key: str, near: Sequence[str], known: Iterable[str]) -> ConfigError:
    hint, listed = f"; did you mean `{near[0]}`?" if near else "", ", ".join(known)
    text = f"unknown key `{key}`{hint} (known: {listed})"
    return ConfigError(text, key=key, expected=f"one of {listed}", suggestions=tuple(near))
