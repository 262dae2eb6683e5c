"""Typed views of configurations, for the JAX implementation: the crate reads and checks, and states every default.

>>> from jax_aero import rust
>>> scenario_config(rust.load_config("test2")).controller.momentum.c0
50.0
"""

from __future__ import annotations

import copy
import shutil
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

import msgspec

from jax_aero.base import crate
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
    return msgspec.convert(crate.resolve_config(config), ScenarioConfig)


def aero_config(aero: Mapping[str, Any]) -> AeroConfig:
    """Return the typed view of an aerodynamic model's configuration.

    Raises
    ------
    ConfigError
        If a key or value is invalid.
    """
    typed: AeroConfig = msgspec.convert(crate.resolve_aero(aero), AeroConfig)
    return typed


OUTSIDE, COPIES = "(outside the repository)", "files"
"""What stands in a manifest for the folder of a file outside the repository; the folder of a result with its copy."""


def make_paths_absolute(config: Mapping[str, Any], folder: Path | None = None) -> crate.Config:
    """Return a configuration with absolute paths, from one with portable paths, as in a manifest.

    They are relative to the repository; files outside it are in `folder`, that of the result, if `copy_outside` has
    copied them.
    """
    placed = copy.deepcopy(dict(config))
    for key in crate.path_keys(placed):
        text = str(get(placed, key))
        path = HOME / text
        if folder is not None and text.startswith(OUTSIDE):
            path = folder / COPIES / Path(text).name
        if path.is_file():
            set_key(placed, key, str(path.resolve()))
    return placed


def copy_outside(config: Mapping[str, Any], folder: Path) -> None:
    """Copy recordings outside the repository that a configuration names into the folder of its result.

    A robot or a card names further files, and is not copied.
    """
    for key in crate.path_keys(config):
        path = Path(get(config, key))
        if make_portable(path).startswith(OUTSIDE) and path.suffix.lower() not in {".toml", ".json", ".urdf"}:
            (folder / COPIES).mkdir(exist_ok=True)
            shutil.copyfile(path, folder / COPIES / path.name)


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
        return path.relative_to(HOME).as_posix() if inside else f"{OUTSIDE}/{path.name}"
    return value
