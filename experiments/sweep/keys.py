"""Settings of a sweep: dotted keys, and `wind.speed` and `wind.direction_deg`, which set `wind.velocity`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jax_aero.keys import set_key
from jax_aero.wind_direction import speed_and_direction, wind_from

POLAR = ("wind.speed", "wind.direction_deg")


def set_all(config: dict[str, Any], settings: Mapping[str, Any]) -> None:
    """Set every key in place; a number as a part of a key is an index into a list."""
    settings = dict(settings)
    polar = {key: float(settings.pop(key)) for key in POLAR if key in settings}
    for key, value in settings.items():
        set_key(config, key, value)
    if polar:
        speed, direction = speed_and_direction(config["wind"]["velocity"])
        config["wind"]["velocity"] = wind_from(polar.get(POLAR[0], speed), polar.get(POLAR[1], direction))
