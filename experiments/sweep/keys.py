"""Settings: dotted keys, `wind.speed` and `wind.direction_deg` of the horizontal part of `wind.velocity`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

from jax_aero import tables
from jax_aero.io import drop_absent
from jax_aero.keys import get, parts, set_key
from jax_aero.wind_direction import speed_and_direction, wind_from

WIND = ("wind", "wind.velocity")
POLAR = ("wind.speed", "wind.direction_deg")


def set_all(config: dict[str, Any], *layers: Mapping[str, Any]) -> None:
    """Set or remove every key in place, layer by layer; a number as a part of a key is an index into a list.

    Speed and direction of the wind come last, whatever their order, unless a later layer sets the wind itself.

    Raises
    ------
    ValueError
        If a key cannot be set; the message names the key, its value and what was expected.
    """
    polar: dict[str, Any] = {}
    for settings in layers:
        if any(key in settings for key in WIND):
            polar.clear()
        for key, value in settings.items():
            if key in POLAR:
                polar[key] = value
            else:
                set_key(config, key, value)
    if polar:
        given = tables.convert(polar, dict[str, float], "settings")
        wind = {"wind.velocity": get(config, "wind.velocity")}
        velocity = tables.convert(wind, dict[str, tuple[float, float, float]], f"to set {' and '.join(polar)}")
        speed, direction = speed_and_direction(velocity["wind.velocity"])
        *horizontal, _ = wind_from(given.get(POLAR[0], speed), given.get(POLAR[1], direction))
        config["wind"]["velocity"] = [*horizontal, velocity["wind.velocity"][2]]
    drop_absent(config)


def replacing(key: str, value: Any) -> Iterator[str]:
    """Yield the keys that overwrite this setting, in whole or part, if they are set later."""
    if key in POLAR:  # set last, so that the wind does not overwrite them
        yield key
        return
    for part, _ in parts(value, key):
        yield from itertools.accumulate(part.split("."), lambda table, name: f"{table}.{name}")
