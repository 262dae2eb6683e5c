"""The result of a flight by any engine. NumPy only."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Progress = Callable[[int, int], None]
"""Called with (ticks flown, ticks in all), or with (flights flown, flights in all) of a batch."""


Outcome = Literal["completed", "off_course", "fell", "diverged"]
"""How a flight ended."""


def ending(outcome: str, lost_time: float | None, lost_reason: str | None) -> str:
    """Say how a flight ended: "completed", or "fell at 21.4 s (rotation error 90.1 deg)".

    Result files have NaN and the empty text for no time and no reason.
    """
    words = outcome.replace("_", " ")
    if lost_time is None or math.isnan(lost_time):
        return words
    return f"{words} at {lost_time:.1f} s" + (f" ({lost_reason})" if lost_reason else "")


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


class RobotNames(Protocol):
    """The part of a robot that labels a log; `jax_aero.rust.Robot` is one."""

    @property
    def joint_names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def joint_groups(self) -> Mapping[str, Sequence[str]]: ...  # noqa: D102
    @property
    def aero_link_names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def jet_names(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def foot_names(self) -> Sequence[str]: ...  # noqa: D102


def labels_of(robot: RobotNames) -> dict[str, Sequence[str]]:
    """Return names of the entries along every dimension of a signal (`rust.signals`) but time."""
    return {
        "xyz": ["x", "y", "z"],
        "wxyz": ["w", "x", "y", "z"],
        "rpy": ["roll", "pitch", "yaw"],
        "six": ["linear_x", "linear_y", "linear_z", "angular_x", "angular_y", "angular_z"],
        "joint": robot.joint_names,
        "jet": robot.jet_names,
        "link": robot.aero_link_names,
        "qp": ["momentum", "torque"],
        "foot": robot.foot_names,
    }


LAB_FORMAT = ("flight-lab-run", 1)
"""Format and version of the `run.json` that the flight lab exports."""


def from_lab(document: Mapping[str, Any]) -> FlightResult:
    """Return the flight in a `run.json` of the flight lab, to the last bit."""
    if (found := (document.get("format"), document.get("version"))) != LAB_FORMAT:
        raise ValueError(f"`format` and `version` are {found}; expected {LAB_FORMAT}")

    def signal(name: str) -> NDArray[np.float64]:
        entry = document["log"][name]
        values = np.frombuffer(base64.b64decode(entry["data"], validate=True), dtype="<f8")
        if values.size != math.prod(entry["shape"]):
            raise ValueError(f"`{name}` has {values.size} numbers; expected shape {entry['shape']}")
        return values.reshape(entry["shape"]).astype(np.float64)

    return FlightResult(
        log={name: signal(name) for name in document["log"]},
        joint_setpoint=np.asarray(document["joint_setpoint"], dtype=np.float64),
        outcome=document["outcome"],
        lost_time=document["lost_time"],
        lost_reason=document["lost_reason"],
        # JSON has no infinity and no NaN.
        summary={name: math.nan if value is None else value for name, value in document["summary"].items()},
    )
