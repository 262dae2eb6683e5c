"""What a flight leaves behind, from whichever engine flew it. NumPy only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Progress = Callable[[int, int], None]
"""Called with (ticks flown, ticks in all), or with (flights flown, flights in all) of a batch."""


Outcome = Literal["completed", "off_course", "fell", "diverged"]
"""How a flight ended."""


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
        "completed"; "off_course": flown to the end, but further from its set-point than `simulator.course_error`;
        "fell"; "diverged": with numbers that physics excludes.
    lost_time, lost_reason
        When [s] and by which criterion the flight ended early; `None` if it reached its end.
    summary
        Figures of merit, which `rust.figures` declares.
    """

    log: Mapping[str, NDArray[np.float64]]
    joint_setpoint: NDArray[np.float64]
    outcome: Outcome
    lost_time: float | None
    lost_reason: str | None
    summary: Mapping[str, float]

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        return self.log[signal]
