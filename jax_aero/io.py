"""Reading of a TOML file as one resolved table or as types of `jax_aero.config`, without the compiled crate.

A table may name another file as its `base`: that file's table is read first, and the keys beside `base` are laid over
it, table by table. A key that may be absent is removed by `false`. Paths start at the file that names them. Which keys
are paths or may be absent, and which tables are of several kinds, the types say; no key is judged before all files are
merged.

>>> table = load_config("test2", {"wind.velocity": [0.0, -12.0, 0.0]})
>>> table["wind"]["profile"]
'ramp'
>>> scenario_config(table).controller.momentum.c0
50.0
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from msgspec import inspect

from jax_aero import tables
from jax_aero.config import AeroConfig, ControllerSection, ScenarioConfig
from jax_aero.keys import set_key
from jax_aero.places import HOME, find

Table = dict[str, Any]

MAX_DEPTH = 16
"""Greatest depth of references between `base` files."""

MAX_FILES = 256
"""Greatest number of files in one configuration."""

FLIGHT = inspect.type_info(ScenarioConfig)
AERO = inspect.type_info(AeroConfig)
CONTROLLER = inspect.type_info(ControllerSection)


def load_config(path: str | PathLike[str], overrides: Mapping[str, Any] | None = None) -> Table:
    """Read an experiment by name or path, resolve every `base` and path, and set the dotted keys of `overrides`.

    Raises
    ------
    ValueError
        If a file cannot be read or parsed or refers to itself, or if a key cannot be set; the message names it.
    """
    table = resolve(find("experiments", path))
    for key, value in (overrides or {}).items():
        override(table, key, value)
    return table


def override(table: Table, key: str, value: Any) -> None:
    """Set a dotted key, or remove it. Its paths start at the current folder: there is no file at which they could."""
    *parents, last = key.split(".")
    place: inspect.Type | None = FLIGHT
    for part in parents:
        place = _place_of_key(place, part)
    entry = {last: tables.to_builtins(value)}
    for inner, name in paths(entry, place):
        inner[name] = str(Path(inner[name]).resolve())
    set_key(table, key, entry[last])
    drop_absent(table)


def drop_absent(table: Table, place: inspect.Type | None = FLIGHT) -> None:
    """Remove the keys of a table that are to be absent: those that are `false` and that may be."""
    for key, value in list(table.items()):
        below = _place_of_key(place, key)
        if value is False and any(isinstance(option, inspect.NoneType) for option in _alternatives(below)):
            del table[key]
        elif isinstance(value, dict):
            drop_absent(value, below)


def scenario_config(table: Mapping[str, Any]) -> ScenarioConfig:
    """Return the typed configuration of a resolved table.

    Raises
    ------
    ValueError
        If a value is invalid; the message names the key, its value and what was expected.
    """
    return tables.convert(tables.to_builtins(table), ScenarioConfig, "configuration")


def check_config(table: Mapping[str, Any]) -> None:
    """Refuse configurations of JAX flights that the crate refuses, with its message; without the crate do nothing."""
    try:
        from jax_aero import rust
    except ImportError:
        return
    rust.check_config({**table, "engine": "jax"})


def aero_config(table: Mapping[str, Any]) -> AeroConfig:
    """Return the typed configuration of an aerodynamic model."""
    found: AeroConfig = tables.convert(tables.to_builtins(table), AeroConfig, "aerodynamic model")  # type: ignore[arg-type]
    return found


def paths(table: Table, place: inspect.Type | None = FLIGHT) -> Iterator[tuple[Table, str]]:
    """Yield every path in a resolved table, as the table that holds it and its key."""
    for key, value in table.items():
        below = _place_of_key(place, key)
        if isinstance(value, dict):
            yield from paths(value, below)
        elif isinstance(value, str) and _is_path(below):
            yield table, key


def make_paths_absolute(config: Mapping[str, Any]) -> Table:
    """Return a configuration with absolute paths, from one with paths relative to the repository, as in a manifest."""
    placed = copy.deepcopy(dict(config))
    for table, key in paths(placed):
        if (HOME / table[key]).is_file():
            table[key] = str(HOME / table[key])
    return placed


def resolve(path: str | PathLike[str], kind: inspect.Type | None = FLIGHT) -> Table:
    """Read a TOML file with a table of this type, and resolve every `base` and path in it."""
    count = iter(range(MAX_FILES))

    def read(path: Path, place: inspect.Type | None, depth: int) -> Table:
        if depth > MAX_DEPTH:
            raise tables.ConfigError(f"{path}: `base` files refer to one another more than {MAX_DEPTH} deep")
        if next(count, None) is None:
            raise tables.ConfigError(f"{path}: more than {MAX_FILES} `base` files are read")
        return resolve_table(tables.read(path), place, path.parent, depth)

    def resolve_table(table: Table, place: inspect.Type | None, folder: Path, depth: int) -> Table:
        # In a table with names of robot parts as keys, a `base` that is not a string is such a name.
        has_names = any(isinstance(option, inspect.DictType) for option in _alternatives(place))
        is_name = has_names and not isinstance(table.get("base"), str)
        base = None if is_name else table.pop("base", None)
        for key, value in table.items():
            below = _place_of_key(place, key)
            if isinstance(value, dict):
                table[key] = resolve_table(value, below, folder, depth)
            elif isinstance(value, str) and _is_path(below):
                table[key] = _absolute_path(folder / value)
        if base is None:
            return table
        if not isinstance(base, str):
            raise tables.ConfigError(f"`base` in {folder} is {base!r}; expected the path of a TOML file")
        return _lay_over(read(folder / base, place, depth + 1), place, table)

    table = read(Path(path), kind, 0)
    drop_absent(table, kind)
    return table


def _lay_over(under: Table, place: inspect.Type | None, over: Table) -> Table:
    """Return `under` overridden by `over`: tables are merged, other values replaced; `place` is their type.

    A table of a different kind replaces the whole table, since the old kind's keys would be unknown in it.
    """
    tag = _tag(place)
    if tag in under and tag in over and under[tag] != over[tag]:
        return over
    merged = dict(under)
    for key, value in over.items():
        before = merged.get(key)
        is_pair = isinstance(before, dict) and isinstance(value, dict)
        merged[key] = _lay_over(before or {}, _place_of_key(place, key), value) if is_pair else value
    return merged


def _absolute_path(path: Path) -> str:
    try:
        return str(path.resolve(strict=True))
    except OSError as reason:
        raise tables.ConfigError(f"cannot read {path}: {reason.strerror}") from None


# --- types of places in a configuration --------------------------------------------------------------------------


def _alternatives(place: inspect.Type | None) -> tuple[inspect.Type, ...]:
    """Return the types that a value at this place may have."""
    return place.types if isinstance(place, inspect.UnionType) else () if place is None else (place,)


def _place_of_key(place: inspect.Type | None, key: str) -> inspect.Type | None:
    """Return the place of a key of a table, from the alternative that has the key."""
    for option in _alternatives(place):
        if isinstance(option, inspect.DictType):
            return option.value_type
        for field in option.fields if isinstance(option, inspect.StructType) else ():
            if field.encode_name == key:
                return field.type
    return None


def _is_path(place: inspect.Type | None) -> bool:
    return any(isinstance(option, inspect.CustomType) and option.cls is Path for option in _alternatives(place))


def _tag(place: inspect.Type | None) -> str | None:
    """Return the key that distinguishes the alternatives of a table, if there are several."""
    return next((option.tag_field for option in _alternatives(place) if isinstance(option, inspect.StructType)), None)
