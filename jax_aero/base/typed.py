"""Typed views of configurations, for the JAX implementation: the crate reads and checks, and states every default.

>>> from jax_aero import rust
>>> scenario_config(rust.load_config("test2")).controller.momentum.c0
50.0
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

import msgspec

from jax_aero import rust
from jax_aero.base.keys import get, set_key
from jax_aero.base.places import HOME
from jax_aero.config import AeroConfig, ScenarioConfig


def scenario_config(config: Mapping[str, Any]) -> ScenarioConfig:
    """Return the typed view of a flight's configuration.

    Raises
    ------
    ConfigError
        If a key or value is invalid; whether the flight can be flown is checked by `rust.check_config`.
    """
    return msgspec.convert(rust.resolve_config(config), ScenarioConfig)


def aero_config(aero: Mapping[str, Any]) -> AeroConfig:
    """Return the typed view of an aerodynamic model's configuration.

    Raises
    ------
    ConfigError
        If a key or value is invalid.
    """
    found: AeroConfig = msgspec.convert(rust.resolve_aero(aero), AeroConfig)
    return found


def make_paths_absolute(config: Mapping[str, Any]) -> rust.Config:
    """Return a configuration with absolute paths, from one with paths relative to the repository, as in a manifest."""
    placed = copy.deepcopy(dict(config))
    for key in rust.path_keys(placed):
        if (path := HOME / get(placed, key)).is_file():
            set_key(placed, key, str(path))
    return placed


def make_portable(value: Any) -> Any:
    """Return `value` with absolute paths made relative to the repository, or outside it reduced to their names."""
    if isinstance(value, Mapping):
        return {key: make_portable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [make_portable(item) for item in value]
    if isinstance(value, PurePath):
        value = str(value)
    if isinstance(value, str) and Path(value).is_absolute():
        path = Path(value)
        inside = path.is_relative_to(HOME)
        return path.relative_to(HOME).as_posix() if inside else f"(outside the repository)/{path.name}"
    return value
