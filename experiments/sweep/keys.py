"""Settings: dotted keys, `wind.speed` and `wind.direction_deg` of the horizontal part of `wind.velocity`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jax_aero import tables
from jax_aero.keys import get, set_key
from jax_aero.wind_direction import speed_and_direction, wind_from

POLAR = ("wind.speed", "wind.direction_deg")


def set_all(config: dict[str, Any], settings: Mapping[str, Any]) -> None:
    """Set every key in place; a number as a part of a key is an index into a list.

    The values of an axis are floats: where one replaces an integer, it becomes one, unless it has a fraction.

    Raises
    ------
    ValueError
        Naming a key that cannot be set, or what it was to change, with its value and what was expected.
    """
    for key, value in settings.items():
        if key not in POLAR:
            replaces_integer = type(get(config, key)) is int and isinstance(value, float) and value.is_integer()
            set_key(config, key, int(value) if replaces_integer else value)
    polar = {key: settings[key] for key in POLAR if key in settings}
    if polar:
        given = tables.convert(polar, dict[str, float], "settings")
        wind = {"wind.velocity": get(config, "wind.velocity")}
        velocity = tables.convert(wind, dict[str, tuple[float, float, float]], f"to set {' and '.join(polar)}")
        speed, direction = speed_and_direction(velocity["wind.velocity"])
        *horizontal, _ = wind_from(given.get(POLAR[0], speed), given.get(POLAR[1], direction))
        config["wind"]["velocity"] = [*horizontal, velocity["wind.velocity"][2]]
