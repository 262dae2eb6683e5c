"""Typed values from TOML files of studies: a `Table` declares keys, types and ranges; `load` refuses everything else.

The crate reads the files, with their `base` files and changed keys, and checks them by the JSON Schema of the type, as
those of flights. A refusal names file, key and value, and what was expected:

>>> class Wind(Table, frozen=True):
...     speeds: tuple[Positive, ...]
...     is_gusty: bool = False
>>> convert({"speeds": [3.0, -1.0]}, Wind, "wind.toml")
Traceback (most recent call last):
jax_aero.base.terminal.ConfigError: wind.toml: `speeds[1]` is -1.0; expected a number > 0
>>> convert({"speed": [3.0]}, Wind, "wind.toml")
Traceback (most recent call last):
jax_aero.base.terminal.ConfigError: wind.toml: unknown key `speed`; did you mean `speeds`? (known: is_gusty, speeds)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar, cast

import msgspec

from jax_aero.base import crate
from jax_aero.base.terminal import ConfigError

T = TypeVar("T")

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
    """Read a TOML file, without a check of its keys, which have the order of the file."""
    return crate.read_toml(path)


def load(path: Path, kind: type[T], changes: Mapping[str, Any] | None = None) -> T:
    """Read a file into its type, with some dotted keys replaced as by `rust.load_config`."""
    table = crate.read_table(path, schema(kind), changes or {})
    return _typed(_in_order_of(read(path), table), kind, str(path))


def convert(table: Mapping[str, Any], kind: type[T], origin: str, folder: Path = Path()) -> T:
    """Convert a plain table to its type; `origin` names it in refusals, and its paths are relative to `folder`."""
    try:
        plain = crate.check_table(table, schema(kind), folder)
    except ConfigError as refusal:
        raise refusal.in_file(origin) from None
    return _typed(_in_order_of(table, plain), kind, origin)


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


def schema(kind: Any) -> dict[str, Any]:
    """Return the JSON Schema of a type."""
    return msgspec.json.schema(kind, schema_hook=lambda _: {"type": "string", "format": "path"})


def _in_order_of(written: Any, plain: Any) -> Any:
    """Return a checked value, whose keys the crate sorts, with its keys in the order in which they were written."""
    if isinstance(plain, dict) and isinstance(written, Mapping):
        return {
            key: _in_order_of(written.get(key), plain[key]) for key in dict.fromkeys((*written, *plain)) if key in plain
        }
    if isinstance(plain, list) and isinstance(written, list | tuple) and len(plain) == len(written):
        return [_in_order_of(*pair) for pair in zip(written, plain, strict=True)]
    return plain


def _typed(plain: Mapping[str, Any], kind: type[T], origin: str) -> T:
    """Return a table that matches the schema as its type, whose own checks may refuse it."""
    try:
        return msgspec.convert(plain, kind, dec_hook=_existing_file)
    except msgspec.ValidationError as refusal:
        text, _, place = str(refusal).partition(" - at `$")
        expected = text.replace("Expected `str` matching regex", "a text that matches")
        key, value = place.partition("[...]")[0].strip(".`"), cast(Any, plain)  # of an entry by name: its table
        for part in re.findall(r"[^.\[\]]+", key):
            value = value[int(part)] if isinstance(value, list) else value[part]
        cause = refusal.__cause__
        own = cause.in_table(key, value) if isinstance(cause, ConfigError) else ConfigError.of(key, value, expected)
        raise own.in_file(origin) from None


def _existing_file(kind: Any, value: Any) -> Path:
    """Return the path of a file, the only type here that msgspec does not support."""
    if kind is not Path or not Path(value).is_file():
        raise ConfigError.of("", value, "the path of a file")
    return Path(value)
