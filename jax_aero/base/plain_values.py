"""Plain values of configurations, as files hold them: numbers, texts, lists and tables; and their text in TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from os import PathLike, fspath
from typing import Any

import msgspec

from jax_aero.base.keys import join
from jax_aero.base.terminal import ConfigError


def to_builtins(config: Any) -> Any:
    """Return a copy of a configuration as a file would hold it.

    Types become tables, every default written out; arrays, NumPy's numbers and paths become lists, numbers and texts.
    """
    return msgspec.to_builtins(config, enc_hook=_to_builtin)


def to_table(config: msgspec.Struct) -> dict[str, Any]:
    """Return what a file of this configuration would hold: as `to_builtins`, without the keys that have no value."""

    def drop_absent(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [drop_absent(item) for item in value]
        if isinstance(value, dict):
            return {key: drop_absent(item) for key, item in value.items() if item is not None}
        return value

    table: dict[str, Any] = drop_absent(to_builtins(config))
    return table


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
    inner = [toml(value, join(section, toml_key(key))) for key, value in table.items() if isinstance(value, Mapping)]
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
