"""What a flight leaves behind, from whichever engine flew it. NumPy only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Progress = Callable[[int, int], None]
"""Called with (ticks flown, ticks in all), or with (flights flown, flights in all) of a batch."""


@dataclass(frozen=True)
class FlightResult:
    """One flight: its log and how it ended.

    Attributes
    ----------
    log
        Signal name to array; the first axis is time. `rust.signals` declares every signal, with its unit.
    joint_setpoint
        Posture of the first tick, which the controller keeps pulling towards [rad].
    outcome
        "completed", or "fell" when the simulator's fall criterion was met.
    fall_time, fall_reason
        When [s] and by which criterion; `None` for a completed flight.
    summary
        Figures of merit, which `rust.figures` declares.
    """

    log: Mapping[str, NDArray[np.float64]]
    joint_setpoint: NDArray[np.float64]
    outcome: Literal["completed", "fell"]
    fall_time: float | None
    fall_reason: str | None
    summary: Mapping[str, float]

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        return self.log[signal]
