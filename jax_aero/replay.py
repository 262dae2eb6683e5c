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

REPRODUCED = 1e-3
"""Greatest difference of torques that a rounding of the log may make, in parts of the greatest torque."""

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


def ticks_reproduced(
    log: logs.Log, config: rust.Config, path: Path, computed: Mapping[str, Array], seed: int = 0
) -> int:
    """Return in how many ticks what the controller computes is that of the log, whatever its last digits are.

    From then on a second replay, with every measurement changed by about a rounding of the log, has other torques: the
    controller's own memory does not reproduce, and a difference from the log says nothing of the log.
    """
    steps = int(rust.resolve_config(config)["controller"]["torque"]["steps"])
    needed = () if config["controller"].get("estimator") else ("raw_joint_velocity",)
    recorded, is_recorded = measured.of_controller(log, config, path, also=needed)
    raw, rng = [name for name in recorded if name.startswith("raw_")], np.random.default_rng(seed)
    # A rotation of few digits has been replaced by the nearest one.
    read = [recorded[name] for name in raw if name != "raw_base_rotation"]
    is_single = all(np.array_equal(rows, rows.astype(np.float32), equal_nan=True) for rows in read)
    rounding = np.finfo(np.float32 if is_single else np.float64).eps
    near = {name: recorded[name] * (1.0 + rounding * rng.normal(size=recorded[name].shape)) for name in raw}
    torque = rust.replay(config, {**recorded, **near})["joint_torque"][is_recorded[::steps]]
    own = computed["joint_torque"]
    apart = np.abs(torque - own).max(axis=1, initial=0.0) > REPRODUCED * np.abs(own).max(initial=0.0)
    return max(int(np.argmax([*apart, True])), 1)


def refused(recorded: Mapping[str, Array], computed: Mapping[str, Array]) -> dict[tuple[str, ...], int]:
    """Return in how many ticks the controller refused signals that are there, unless it did so in the flight too."""
    counts = {}
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
            counts[names] = int(is_refused.sum())
    return counts
