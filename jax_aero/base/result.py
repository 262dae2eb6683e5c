"""The result of a flight, independent of the back end. NumPy only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from jax_aero.base.places import did_you_mean

if TYPE_CHECKING:
    from jax_aero.base.crate import Robot

Outcome = Literal["completed", "off_course", "landed", "landing", "crashed", "fell", "diverged"]
"""How a flight ended."""

UPRIGHT: tuple[Outcome, ...] = ("completed", "landed")
"""Outcomes of a flight that completes its mission or touches down within the limits of a landing."""

LOST: tuple[Outcome, ...] = tuple(outcome for outcome in get_args(Outcome) if outcome not in UPRIGHT)
"""Outcomes of a flight that is lost: all others."""


def ending(outcome: str, lost_time: float | None, lost_reason: str | None) -> str:
    """Return the outcome in words: "completed", or "fell at 21.4 s (rotation error 90.1 deg)".

    Result files store a missing time as NaN and a missing reason as an empty text.
    """
    words = outcome.replace("_", " ")
    if lost_time is None or math.isnan(lost_time):
        return words
    return f"{words} at {lost_time:.1f} s" + (f" ({lost_reason})" if lost_reason else "")


def brief(thing: Any) -> str:
    """Return an object of a dataclass in a few lines: arrays by their shape, mappings by their size."""

    def part(value: Any) -> str:
        if isinstance(value, np.ndarray):
            return f"array {value.shape}"
        if isinstance(value, Mapping):
            return f"{len(value)} by name"
        text = repr(value)
        return text if len(text) <= 100 else f"{type(value).__name__} …"

    lines = [f"  {name}: {part(value)}" for name, value in vars(thing).items()]
    return "\n".join([type(thing).__name__, *lines])


@dataclass(frozen=True)
class FlightResult:
    """One flight: its log and its outcome.

    Attributes
    ----------
    log
        Arrays by signal name; the first axis is time. `rust.signals` declares every signal, with its unit.
    joint_setpoint
        Posture of the first tick, to which the posture task returns [rad].
    outcome
        "completed"; "off_course": flown to the end, but further than 0.5 m from its set-point; "landed": the mission
        was given up, and the robot touched down within the limits of a landing, "crashed": beyond them, "landing":
        it was on its way at the end; "fell"; "diverged": numbers beyond the divergence limits.
    lost_time, lost_reason
        Time [s] and criterion of the loss; `None` if the flight reached its end.
    summary
        Figures of merit, declared by `rust.figures`.
    """

    log: Mapping[str, NDArray[np.float64]]
    joint_setpoint: NDArray[np.float64]
    outcome: Outcome
    lost_time: float | None
    lost_reason: str | None
    summary: Mapping[str, float]

    def __repr__(self) -> str:
        words, time = ending(self.outcome, self.lost_time, self.lost_reason), self.log.get("time")
        held = "no log" if time is None else f"{len(self.log)} signals of {len(time)} ticks, to {time[-1]:g} s"
        return f"<FlightResult {words}: {held}>"

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        if signal not in self.log:
            raise KeyError(f"no signal `{signal}`{did_you_mean(signal, self.log)}")
        return self.log[signal]


REPEATED = {f"raw_{name}": name for name in ("base_position", "base_velocity", "joint_position", "joint_velocity")} | {
    "raw_thrust": "thrust",
    "raw_wind": "wind",
    "raw_foot_wrench": "foot_wrench",
}
"""Raw measurements that a file leaves out if they have the bits of another signal, as without errors of sensors."""


def is_repeated(signal: str, log: Mapping[str, NDArray[np.float64]]) -> bool:
    """Return whether a file leaves out this signal of a log, also what nothing measures."""
    if signal in ("raw_shaft_speed", "raw_height"):
        return bool(np.isnan(log[signal]).all())
    return signal in REPEATED and log[signal].tobytes() == log[REPEATED[signal]].tobytes()


def labels_of(robot: Robot) -> dict[str, Sequence[str]]:
    """Return the names of the entries along every dimension of a signal (`rust.signals`) except time."""
    return {
        "xyz": ["x", "y", "z"],
        "base_axis": ["x", "y", "z"],
        "wxyz": ["w", "x", "y", "z"],
        "rpy": ["roll", "pitch", "yaw"],
        "six": ["linear_x", "linear_y", "linear_z", "angular_x", "angular_y", "angular_z"],
        "joint": robot.joint_names,
        "jet": robot.jet_names,
        "link": robot.aero_link_names,
        "qp": ["momentum", "torque"],
        "foot": robot.foot_names,
    }


def match_branch(signal: str, ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, of equivalent values of a logged signal (n, ...), those nearest to others: iRonCub starts at a yaw of π.

    Both signs of a quaternion are one rotation, as are angles a turn apart; other signals stay.
    """
    if signal.endswith("base_quaternion"):
        return np.asarray(ours * np.where(np.sum(ours * theirs, axis=1) < 0.0, -1.0, 1.0)[:, None])
    if signal == "base_rpy_setpoint":
        return np.asarray(ours - 2.0 * np.pi * np.round((ours - theirs) / (2.0 * np.pi)))
    return ours
