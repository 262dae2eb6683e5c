"""Flights that stray from their set-point: M148 and M149 of `docs/model/detection.md`, in NumPy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jax_aero import rust
from tests.references.flights import Flown

HORIZON, CONFIRMATION = 0.3, 0.03
"""T and c [s]."""


class TrackingError:
    """Whether a flight strays, tick by tick."""

    def __init__(self, config: Any, mass: float) -> None:
        self.limits, self.mass = config["controller"]["fault_detection"]["tracking_error"], mass
        self.step, self.beyond = config["controller"]["time_step"], 0

    def strays(self, tick: Any) -> bool:
        """Return whether it does in a tick of the crate: from what the law estimated and was given there."""
        state, given = tick.estimates.state, tick.setpoint
        turn = np.asarray(given.rotation).T @ np.asarray(state.base_rotation)
        omega = np.asarray(state.velocity)[3:6]
        turning = np.asarray(given.rotation).T @ omega - np.asarray(given.angular_velocity)
        angle = Rotation.from_matrix(turn).as_rotvec() + HORIZON * turning
        moving = tick.momentum[:3] / self.mass - np.asarray(given.com_velocity)
        away = tick.com_position - np.asarray(given.com_position) + HORIZON * moving
        fastest = np.abs(np.asarray(state.velocity)[6:]).max(initial=0.0)
        values = {"rotation": np.linalg.norm(angle), "position": np.linalg.norm(away), "joint_velocity": fastest}
        is_beyond = any(value > self.limits[name] for name, value in values.items())
        self.beyond = self.beyond + 1 if is_beyond else 0
        return bool((self.beyond - 1) * self.step > CONFIRMATION - 1e-9)


def follow(config: Mapping[str, Any], ticks: Iterable[Flown]) -> tuple[bool, list[bool]]:
    """Return whether a flight is the reference's, and in which ticks it strays."""
    reference, tracks = TrackingError(config, rust.Robot(config["robot"]).mass), [each.tick for each in ticks]
    found = ["tracking_error" in tick.degraded_modes for tick in tracks]
    return found == [reference.strays(tick) for tick in tracks], found
