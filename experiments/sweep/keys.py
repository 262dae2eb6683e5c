"""Settings: dotted keys, `wind.speed` and `wind.direction_deg` of the horizontal part of `wind.velocity`."""

from __future__ import annotations

from collections.abc import Mapping
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


def find_replaced(key: str, earlier: Mapping[str, Any]) -> str | None:
    """Return the first earlier setting that is overwritten, in whole or part, by setting `key`; `None` if none is."""
    for other, value in earlier.items():
        # Speed and direction of the wind are not overwritten by the wind, since they are set last.
        if key == other or (other not in POLAR and any(_is_within(part, key) for part, _ in parts(value, other))):
            return other
    return None


def _is_within(key: str, table: str) -> bool:
    return f"{key}.".startswith(f"{table}.")
