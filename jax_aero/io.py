"""From a TOML file to one resolved table, as the crate reads it; the compiled crate is not needed.

A table may name another file as its `base`: that file's table is read first, and the keys beside `base` are laid over
it, table by table. Paths start at the file that names them. Keys are not judged here: `config.scenario_config` does.

>>> load_config("configs/experiments/test2.toml", {"wind.velocity": [0.0, -12.0, 0.0]})["wind"]["profile"]
'ramp'
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from jax_aero.keys import set_key

Table = dict[str, Any]

MAX_DEPTH = 16
"""How deep `base` files may refer to one another."""

PATH_KEYS = ("robot", "path", "file", "card")
"""Keys whose value is a path, made absolute on reading."""

KINDS = {"aero": "model", "jets": "dynamics", "wind": "profile", "controller_wind": "profile"}
"""Tables of several kinds, with the key that says which kind one is."""


def load_config(path: str | PathLike[str], overrides: Mapping[str, Any] | None = None) -> Table:
    """Read a TOML file and resolve every `base` and path in it; then set the dotted keys of `overrides`.

    Raises
    ------
    ValueError
        Naming the file that cannot be read or parsed or that refers to itself, or the key that cannot be set.
    """
    table = _read(Path(path), "", 0)
    for key, value in (overrides or {}).items():
        override(table, key, value)
    return table


def override(table: Table, key: str, value: Any) -> None:
    """Set a dotted key. There is no file at which a path could start, so it starts at the current folder."""
    is_path = key.rsplit(".", 1)[-1] in PATH_KEYS and isinstance(value, str)
    set_key(table, key, str(Path(value).resolve()) if is_path else value)


def _read(path: Path, name: str, depth: int) -> Table:
    """Return the table of a file, which stands under the key `name`."""
    if depth > MAX_DEPTH:
        raise ValueError(f"{path}: `base` files refer to one another more than {MAX_DEPTH} deep")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as reason:
        raise ValueError(f"cannot read {path}: {reason.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as reason:
        raise ValueError(f"{path}: {reason}") from None
    return _resolve(table, name, path.parent, depth)


def _resolve(table: Table, name: str, folder: Path, depth: int) -> Table:
    base = table.pop("base", None)
    for key, value in table.items():
        if isinstance(value, dict):
            table[key] = _resolve(value, key, folder, depth)
        elif isinstance(value, str) and key in PATH_KEYS:
            table[key] = _absolute(folder / value)
    if base is None:
        return table
    if not isinstance(base, str):
        raise ValueError(f"`base` in {folder} is {base!r}; expected the path of a TOML file")
    return _lay_over(_read(folder / base, name, depth + 1), name, table)


def _lay_over(under: Table, name: str, over: Table) -> Table:
    """Return the keys of both, which are the table `name`; tables merge, everything else is replaced.

    A table of another kind replaces the one below it: keys of that kind would not be understood.
    """
    kind = KINDS.get(name)
    if kind in under and kind in over and under[kind] != over[kind]:
        return over
    merged = dict(under)
    for key, value in over.items():
        below = merged.get(key)
        is_pair = isinstance(below, dict) and isinstance(value, dict)
        merged[key] = _lay_over(below or {}, key, value) if is_pair else value
    return merged


def _absolute(path: Path) -> str:
    try:
        return str(path.resolve(strict=True))
    except OSError as reason:
        raise ValueError(f"cannot read {path}: {reason.strerror}") from None
