"""A flight of the crate with what its controller was given and what it made of that, tick by tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jax_aero import rust

WITHOUT = {"joints_predicted", "rotation_predicted", "velocity_predicted"}
"""Modes of ticks without measured momentum."""


class Flown(NamedTuple):
    """A tick: the measurement, every value of the tick, and the evidence on engines after it."""

    measured: rust.Measurement
    tick: rust.Tick
    engines: dict[str, Any]


def fly(config: Mapping[str, Any]) -> list[Flown]:
    """Return all ticks of a flight."""
    flight, ticks = rust.Flight(config), []
    while not flight.has_ended:
        measured = flight.measurement
        flight.step()
        ticks.append(Flown(measured, flight.last, flight.controller_state.engines()))
    return ticks


def is_wrong(measured: rust.Measurement, modes: set[str]) -> bool:
    """Return whether a part of the momentum is not missing but is replaced: then it is not between two measurements."""
    state = measured.state
    parts = {"joints": [state.joint_position], "rotation": [state.base_rotation], "velocity": [state.velocity[:6]]}
    return any(np.isfinite(of).all() for name, of in parts.items() if f"{name}_predicted" in modes)
