"""Settings: dotted keys, `wind.speed` and `wind.direction_deg` of the horizontal part of `wind.velocity`."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.keys import get, parts
from jax_aero.base.wind_direction import speed_and_direction, wind_from

WIND = ("wind", "wind.velocity")
POLAR = ("wind.speed", "wind.direction_deg")


def set_all(config: Mapping[str, Any], *layers: Mapping[str, Any]) -> rust.Config:
    """Return a configuration with every key set or removed, layer by layer, as by `rust.set_keys`.

    Speed and direction of the wind come last, whatever their order, unless a later layer sets the wind itself.

    Raises
    ------
    ConfigError
        If a key cannot be set; the message names the key, its value and what was expected.
    """
    changes: dict[str, Any] = {}
    polar: dict[str, Any] = {}
    for settings in layers:
        if any(key in settings for key in WIND):
            polar.clear()
        for key, value in settings.items():
            chosen = polar if key in POLAR else changes
            chosen.pop(key, None)  # a key that is set again is set last
            chosen[key] = value
    changed = rust.set_keys(config, changes)
    if polar:
        given = tables.convert(polar, dict[str, float], "settings")
        wind = {"wind.velocity": get(changed, "wind.velocity")}
        velocity = tables.convert(wind, dict[str, tuple[float, float, float]], f"to set {' and '.join(polar)}")
        speed, direction = speed_and_direction(velocity["wind.velocity"])
        *horizontal, _ = wind_from(given.get(POLAR[0], speed), given.get(POLAR[1], direction))
        changed["wind"]["velocity"] = [*horizontal, velocity["wind.velocity"][2]]
    return changed


def replacing(key: str, value: Any) -> Iterator[str]:
    """Yield the keys that overwrite this setting, in whole or part, if they are set later."""
    if key in POLAR:  # set last, so that the wind does not overwrite them
        yield key
        return
    for part, _ in parts(value, key):
        yield from itertools.accumulate(part.split("."), lambda table, name: f"{table}.{name}")


def join(layers: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the settings of all layers in one table; lists of tables of the same key, as outages, are joined."""
    joined: dict[str, Any] = {}
    for key, value in (item for settings in layers for item in settings.items()):
        joined[key] = [*joined[key], *value] if key in joined and are_joined(joined[key], value) else value
    return joined


def are_joined(*values: Any) -> bool:
    """Return whether all values are lists of tables."""
    return all(isinstance(value, list) and all(isinstance(entry, Mapping) for entry in value) for value in values)


def do_conflict(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Return whether a setting of the second replaces one of the first, in whole or part."""
    taken = {part for key, value in first.items() for part in replacing(key, value)}
    return any(key in taken and not are_joined(first.get(key), value) for key, value in second.items())
