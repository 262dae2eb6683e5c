"""What the crate declares, as Python values: configurations, their schemas, robots, signals and figures of merit.

`jax_aero.rust` has all of it too, and what computes with it.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from types import MappingProxyType
from typing import Any

from jax_aero import _core
from jax_aero._core import Robot, read_urdf
from jax_aero.base.keys import parts
from jax_aero.base.places import find
from jax_aero.base.plain_values import to_builtins
from jax_aero.base.terminal import ConfigError

__all__ = [
    "Config",
    "Quantity",
    "Robot",
    "changes_to_json",
    "check_config",
    "check_table",
    "config_digest",
    "figures",
    "load_aero",
    "load_config",
    "load_controller",
    "load_onboard",
    "parsed",
    "path_keys",
    "read_table",
    "read_toml",
    "read_urdf",
    "resolve_aero",
    "resolve_config",
    "schemas",
    "set_keys",
    "signals",
    "to_json",
]

Config = dict[str, Any]
"""A resolved flight configuration: nested tables of plain values, including every default."""


def load_config(path: str | PathLike[str], changes: Mapping[str, Any] | None = None) -> Config:
    """Read a flight configuration, merge its base files, apply changes, and check it.

    Parameters
    ----------
    path
        The name of an experiment, such as `test2`, or the path of a TOML file. A file anywhere reads as if it stood in
        `configs/experiments`: `base = "test2"`, and every path in it, means a file beside it, or else one from there.
    changes
        Values by dotted key, such as `{"wind.velocity": [0, -12, 0]}`; arrays and paths are also accepted. Paths start
        at the current folder, and `false` removes what may be absent.

    Raises
    ------
    ConfigError
        If a file or value is invalid; it has file, key, value, what was expected and suggestions as attributes.
    """
    return parsed(_core.load_config(find("experiments", path), changes_to_json(changes or {})))


def check_config(config: Mapping[str, Any]) -> None:
    """Raise `ConfigError`, naming key, value and what was expected, unless the configuration can be flown."""
    _core.check_config(to_json(config))


def resolve_config(config: Mapping[str, Any]) -> Config:
    """Return a configuration with every default; raise `ConfigError` for keys and values that no flight may have."""
    return parsed(_core.resolve_config(to_json(config)))


def set_keys(config: Mapping[str, Any], changes: Mapping[str, Any]) -> Config:
    """Return a configuration with dotted keys set as by `load_config`, without a check of the result."""
    return parsed(_core.set_keys(to_json(config), changes_to_json(changes)))


def path_keys(config: Mapping[str, Any]) -> list[str]:
    """Return the dotted keys of all paths in a configuration, which need not be valid."""
    return _core.path_keys(to_json(config))


def load_aero(path: str | PathLike[str]) -> Config:
    """Read an aerodynamic model's configuration, by its name in `configs/aero` or the path of a file."""
    return parsed(_core.load_table("aero", find("aero", path)))


def load_controller(path: str | PathLike[str]) -> Config:
    """Read a controller's configuration, by its name in `configs/control` or the path of a file."""
    return parsed(_core.load_table("control", find("control", path)))


def load_onboard(path: str | PathLike[str]) -> Config:
    """Read robot, controller and mission on board, by their name in `configs/onboard` or the path of a file."""
    return parsed(_core.load_table("onboard", find("onboard", path)))


def resolve_aero(aero: Mapping[str, Any]) -> Config:
    """Return an aerodynamic model's configuration with every default, as `resolve_config`."""
    return parsed(_core.resolve_aero(to_json(aero)))


def read_toml(path: str | PathLike[str]) -> Config:
    """Read a TOML file, without a check of its keys."""
    return parsed(_core.read_toml(path))


def read_table(path: str | PathLike[str], schema: Mapping[str, Any], changes: Mapping[str, Any]) -> Config:
    """Read a TOML file with its base files, set dotted keys as by `load_config`, and check it by a JSON Schema."""
    return parsed(_core.read_table(path, changes_to_json(changes), json.dumps(schema)))


def check_table(table: Mapping[str, Any], schema: Mapping[str, Any], folder: str | PathLike[str]) -> Config:
    """Return a table whose paths start at `folder`, as `read_table` does that of a file."""
    return parsed(_core.check_table(to_json(table), folder, json.dumps(schema)))


def schemas() -> dict[str, dict[str, Any]]:
    """Return the JSON Schemas of the crate's configuration files, by folder of `configs/`."""
    return parsed(_core.schemas())


@dataclass(frozen=True)
class Quantity:
    """Declaration of a signal of the log, or of a figure of merit.

    Attributes
    ----------
    label
        Name in plots and tables.
    dims
        Names of its dimensions; without "time" it has one value for the flight.
    unit, meaning
        Unit and description, as in result files.
    shown
        Unit in which it is shown; empty for the usual one.
    numbers
        What its values are: "real", "integer", "code", or "bits" for sums of them.
    codes
        What codes and bits stand for, by name.
    is_of_ground
        Whether only engines with ground contact have it.
    is_tabled
        Whether tables of flights show it.
    is_error
        Whether it is an error, of which a lost flight counts as having the greatest.
    """

    label: str
    dims: tuple[str, ...]
    unit: str
    shown: str
    meaning: str
    numbers: str
    codes: Mapping[str, int]
    is_of_ground: bool
    is_tabled: bool
    is_error: bool


def _declared(declarations: str) -> Mapping[str, Quantity]:
    quantities = {}
    for row in json.loads(declarations):
        name, label = row.pop("name"), row.pop("label")
        codes = {meaning: code for code, meaning in row.pop("codes")}
        quantities[name] = Quantity(label or name.replace("_", " "), tuple(row.pop("dims")), codes=codes, **row)
    return MappingProxyType(quantities)


@functools.cache
def signals() -> Mapping[str, Quantity]:
    """Return the declarations of all signals by name."""
    return _declared(_core.signals())


@functools.cache
def figures() -> Mapping[str, Quantity]:
    """Return the declarations of all figures of merit by name."""
    return _declared(_core.figures())


def config_digest(config: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the configuration and the files that it names, equal on every machine."""
    return _core.config_digest(to_json(config))


class _Table(Config):
    """A configuration that is shown in a line for each of its tables."""

    def __repr__(self) -> str:
        lines = (f"{key}: {value}" for key, value in self.items())
        return "\n".join(line if len(line) <= 100 else f"{line[:99]}…" for line in lines)


def parsed(text: str) -> Config:
    """Return a configuration from JSON."""
    return _Table(json.loads(text))


def changes_to_json(changes: Mapping[str, Any]) -> str:
    """Return values by dotted key as JSON."""
    return json.dumps([[key, json.loads(to_json(value, key))] for key, value in changes.items()])


def to_json(value: Any, key: str = "") -> str:
    """Return a configuration, or the value of a key, as JSON."""
    if isinstance(value, str | PathLike) and not key:
        raise ConfigError.of("", str(value), f"a table, such as load_config({str(value)!r}) returns")
    plain = to_builtins(value)
    try:
        return json.dumps(plain, allow_nan=False)
    except ValueError:
        numbers = ((name, part) for name, part in parts(plain, key) if isinstance(part, float))
        name, number = next(one for one in numbers if not math.isfinite(one[1]))
        raise ConfigError.of(name, number, "a finite number") from None
