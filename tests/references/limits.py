"""Limits of thrusts, joints and torques in a tick, with what is found of them: M65, M70 and M72, in NumPy.

The numbers are read from the robot's files here, so that each has its unit and its axis once more.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from tests.references.flights import Flown
from tests.references.joints import FREE, STUCK

TRIED = 0.02
"""Greatest velocity of a stuck joint [rad/s, m/s]."""

TOLERANCE = 1e-13
"""Relative difference of bounds: some roundings of a tanh."""


class Limits:
    """Numbers of a robot and its law, in SI units and the robot's order."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        file, law = Path(config["robot"]), config["controller"]
        robot, bounds, torque = tomllib.loads(file.read_text(encoding="utf-8")), law["bounds"], law["torque"]
        urdf = {joint.get("name"): joint for joint in ElementTree.parse(file.parent / robot["urdf"]).iter("joint")}
        rows = []
        for entry in (joint for group in robot["joint_groups"] for joint in group["joints"]):
            joint = urdf[entry["name"]]
            own, turns = joint.find("limit").attrib, joint.get("type") == "revolute"
            unit, suffix = (np.pi / 180.0, "_deg") if turns else (1.0, "")
            ends = entry.get(f"limits{suffix}")
            ends = [unit * end for end in ends] if ends else [float(own["lower"]), float(own["upper"])]
            fast = entry.get(f"velocity_max{suffix}", float(own["velocity"]) / unit)
            fast = (turns and bounds.get("joint_velocity_max_deg")) or fast
            strong = (turns and torque.get("torque_max")) or entry.get("torque_max", float(own["effort"]))
            quick = (turns and torque.get("torque_rate_max")) or entry.get("torque_rate_max", np.inf)
            rows.append([*ends, unit * fast, strong, quick, turns])
        *ends, self.fast, self.strong, self.quick, turns = np.array(rows, float).T
        self.ends, self.turns, jets = ends, turns > 0.0, robot["jets"]
        self.thrust = np.array([[jet.get("thrust_min", 0.0), jet["thrust_max"]] for jet in jets]).T
        self.rate = np.array([bounds["thrust_rate_max"][jet["name"]] for jet in jets])
        self.steep = bounds["thrust_steepness"], bounds["joint_steepness"]
        self.descent = ((law.get("fault_detection") or {}).get("engines") or {}).get("descent")
        self.step = law["time_step"]

    def of_tick(self, tick: rust.Tick, reach: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return bounds of thrust rates and joint velocities, and greatest rates of torques.

        `reach` are the least and greatest thrusts that the engines reach (j, 2) [N].
        """
        known = tick.estimates
        fast, quick = self.fast, self.quick
        if self.descent and np.any(reach[:, 1] - reach[:, 0] < self.descent["range_fraction_min"] * self.thrust[1]):
            speed, rate = np.radians(self.descent["joint_velocity_max_deg"]), self.descent["torque_rate_max"]
            fast = np.where(self.turns, np.maximum(fast, speed), fast)
            quick = np.where(self.turns, np.maximum(quick, rate), quick)
        fast = np.where(tick.joint_condition == STUCK, np.minimum(fast, TRIED), fast)
        most = np.minimum(reach[:, 1], self.thrust[1])
        least = np.minimum(np.maximum(reach[:, 0], self.thrust[0]), most)
        position, velocity = known.state.joint_position, np.asarray(known.state.velocity)[6:]
        lower, upper = [], []
        for x, low, high, r, steep in (
            (known.thrust, least, most, self.rate, self.steep[0]),
            (position, *self.ends, fast, self.steep[1]),
        ):
            lower.append(-r * np.tanh(steep * (np.asarray(x) - low)))
            upper.append(r * np.tanh(steep * (high - np.asarray(x))))
        is_free = tick.joint_condition == FREE
        lower[1], upper[1] = (np.where(is_free, velocity, bound[1]) for bound in (lower, upper))
        return np.concatenate(lower), np.concatenate(upper), quick


def follow(config: Mapping[str, Any], ticks: Iterable[Flown], shares: NDArray[np.float64] | None = None) -> list[str]:
    """Return which limits are not the reference's in some tick of a flight; shares of torques (ticks, n) act."""
    limits, wrong, last = Limits(config), set[str](), None
    for place, (_, tick, engines) in enumerate(ticks):
        lower, upper, quick = limits.of_tick(tick, np.asarray(engines["reaches"]))
        strong = limits.strong * (1.0 if shares is None else shares[place])
        pairs = {"lower": (tick.momentum_qp.lower, lower), "upper": (tick.momentum_qp.upper, upper)}
        pairs |= {"torque lower": (tick.torque_qp.lower, -strong), "torque upper": (tick.torque_qp.upper, strong)}
        if last is not None:
            most, torque = quick * limits.step, last.joint_torque
            pairs["torque rate"] = tick.joint_torque, torque + np.clip(tick.unlimited_torque - torque, -most, most)
        for name, (theirs, ours) in pairs.items():
            theirs = np.asarray(theirs)[: ours.size]
            if not np.allclose(theirs, ours, rtol=TOLERANCE, atol=TOLERANCE):
                wrong.add(name)
        last = tick
    return sorted(wrong)
