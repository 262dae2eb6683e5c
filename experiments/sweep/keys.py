"""Dotted keys into a configuration, and the few that stand for several others.

`wind.speed` and `wind.direction_deg` set `wind.velocity`: the direction is the one the wind comes *from*, seen by a
robot that flies along +x: 0 from ahead, 90 from its left, 180 from behind.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

from experiments import Refused

POLAR = ("wind.speed", "wind.direction_deg")


def get(config: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key, or `None` if there is none."""
    value: Any = config
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return None
        value = value[part]
    return value


def set_all(config: dict[str, Any], settings: Mapping[str, Any]) -> None:
    """Set every key in place; a number as a part of a key is a place in a list."""
    for key, value in settings.items():
        if key not in POLAR:
            _set(config, key, value)
    polar = {key: float(settings[key]) for key in POLAR if key in settings}
    if polar:
        speed, direction = _polar(config["wind"]["velocity"])
        _set(config, "wind.velocity", _velocity(polar.get(POLAR[0], speed), polar.get(POLAR[1], direction)))


def _set(config: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    table: Any = config
    for part in parents:
        table = table[int(part)] if isinstance(table, list) else table.setdefault(part, {})
        if not isinstance(table, dict | list):
            raise Refused(f"cannot set `{key}`: `{part}` is a value, not a table")
    try:
        table[int(last) if isinstance(table, list) else last] = copy.deepcopy(value)
    except (IndexError, ValueError):
        raise Refused(f"cannot set `{key}`: `{last}` is no place in {table}") from None


def _polar(velocity: list[float]) -> tuple[float, float]:
    x, y, _ = velocity
    return math.hypot(x, y), math.degrees(math.atan2(-y, -x))


def _velocity(speed: float, direction_deg: float) -> list[float]:
    angle = math.radians(direction_deg)
    # Rounded, so that wind from the side has no component from ahead.
    return [round(-speed * math.cos(angle), 12) + 0.0, round(-speed * math.sin(angle), 12) + 0.0, 0.0]
