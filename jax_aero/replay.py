"""A recorded log through the tick of a controller, open loop."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.view import logs, measured

Array = NDArray[np.float64]

PREDICTED = {
    "joints_predicted": ("raw_joint_position", "raw_joint_velocity"),
    "position_predicted": ("raw_base_position",),
    "rotation_predicted": ("raw_base_rotation",),
    "velocity_predicted": ("raw_base_velocity",),
}
"""Signals whose prediction a controller uses in these modes, because they are missing or refused."""


def replay(log: logs.Log, config: rust.Config, path: Path) -> tuple[Mapping[str, Array], Mapping[str, Array]]:
    """Return the signals of a log, and those that the controller computes from it, at the law's ticks that it holds."""
    steps = int(rust.resolve_config(config)["controller"]["torque"]["steps"])
    needed = () if config["controller"].get("estimator") else ("raw_joint_velocity",)
    try:
        recorded, is_recorded = measured.of_controller(log, config, path, also=needed)
    except Refused as reason:
        if not needed or needed[0] not in str(reason):
            raise
        raise Refused(f"{reason}; a controller with an estimator needs none, e.g. --experiment test2_sensors") from None
    computed, is_there = rust.replay(config, recorded), is_recorded[::steps]
    before = {name: rows[::steps][is_there] for name, rows in recorded.items()}
    after = {name: rows[is_there] for name, rows in computed.items()}
    for names, count in refused(before, after).items():
        of = f"{count} of {is_there.sum()} ticks with numbers of {' and '.join(f'`{name}`' for name in names)}"
        warnings.warn(f"the controller predicted in their place in {of} (another unit, or jumps?)", stacklevel=2)
    return before, after


def refused(recorded: Mapping[str, Array], computed: Mapping[str, Array]) -> dict[tuple[str, ...], int]:
    """Return in how many ticks the controller refused signals that are there, unless it did so in the flight too."""
    found = {}
    modes, flown = (signals.get("degraded_modes") for signals in (computed, recorded))
    if modes is None:
        return {}
    for mode, names in PREDICTED.items():
        bit = rust.MODES[mode]
        is_there = [
            np.isfinite(rows.reshape(len(rows), -1)).all(axis=1)
            for name in names
            if (rows := recorded.get(name)) is not None
        ]
        is_refused = (np.asarray(modes, int) & bit > 0) & np.all(is_there, axis=0)
        if flown is not None:
            is_refused &= ~(np.nan_to_num(flown).astype(int) & bit > 0)
        if is_refused.any():
            found[names] = int(is_refused.sum())
    return found
