"""Horizontal wind given by its speed and the direction it comes from.

For a robot that flies along +x, the direction is 0 from ahead (+x), 90 from its left (+y) and 180 from behind.
"""

import math
from collections.abc import Sequence


def wind_from(speed: float, direction_deg: float) -> list[float]:
    """Return the velocity (3,) [m/s], inertial axes, of wind that comes from a direction [deg]."""
    angle = math.radians(direction_deg)
    # Rounded, so that wind from the side has no component from ahead; adding zero converts -0.0 to 0.0.
    return [round(-speed * part, 12) + 0.0 for part in (math.cos(angle), math.sin(angle), 0.0)]


def speed_and_direction(velocity: Sequence[float]) -> tuple[float, float]:
    """Return horizontal speed [m/s] and direction [deg, -180 to 180] of a velocity, the inverse of `wind_from`.

    Calm air has direction 0.
    """
    x, y, _ = velocity
    # Subtracted from zero, since the direction of -0.0 is -180.
    return math.hypot(x, y), math.degrees(math.atan2(0.0 - y, 0.0 - x))
