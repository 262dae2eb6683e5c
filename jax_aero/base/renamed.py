"""Old names of keys, values and outcomes, with their new ones; `jax-aero rename` changes files.

>>> new_key(("controller", "engines", "confirmation"))
('controller', 'fault_detection', 'engines', 'confirmation')
>>> hint("flight.toml: unknown key `controller.observer` (known: aero)")
'; renamed to `controller.disturbance_observer`: jax-aero rename FILE'
"""

from __future__ import annotations

import re

KEYS = {
    "engine": "backend",
    "simulator.time_step": "controller.time_step",
    "controller.observer": "controller.disturbance_observer",
    "controller.engines": "controller.fault_detection.engines",
    "controller.engines.descent.range_share_min": "controller.fault_detection.engines.descent.range_fraction_min",
    "controller.joints": "controller.fault_detection.joints",
    "controller.joints.share_max": "controller.fault_detection.joints.effectiveness_max",
    "controller.latency_monitor": "controller.fault_detection.latency",
    "controller.supervisor": "controller.fault_detection.tracking_error",
}
"""Keys of a flight."""

VALUES = {
    ("simulator.jets.dynamics", "second_order"): "throttled",
    ("controller.jet_dynamics", "second_order"): "throttled",
}
"""Values of keys, which have their new names."""

OUTCOMES = {"descended": "landed", "descending": "landing"}
"""Outcomes of a flight, in results and claims."""

MODES = {"straying": "tracking_error"}
"""Modes of a tick."""

SWEEPS = {
    "robot_touches": "robot_pushes",
    "robot_touch_leg": "robot_push_leg",
    **{
        f"ahead_{name}": f"mpc_{name}"
        for name in ("air", "engine_loss", "ensemble", "gusts", "sensors", "turbulence", "worlds")
    },
}
"""Sweeps."""

Key = tuple[str, ...]

_KEYS = {tuple(old.split(".")): tuple(new.split(".")) for old, new in KEYS.items()}


def new_key(key: Key) -> Key:
    """Return the name of a dotted key, whose first parts may have been renamed."""
    for length in range(len(key), 0, -1):
        if new := _KEYS.get(key[:length]):
            return (*new, *key[length:])
    return key


def rows() -> list[tuple[str, str, str]]:
    """Return what was renamed, old and new name."""
    values = {f'{key} = "{old}"': f'"{new}"' for (key, old), new in VALUES.items()}
    kinds = {"key": KEYS, "value": values, "outcome": OUTCOMES, "mode": MODES, "sweep": SWEEPS}
    return [(kind, f"`{old}`", f"`{new}`") for kind, names in kinds.items() for old, new in names.items()]


def hint(message: str) -> str:
    """Return what a refusal says of the old name that it states; empty if there is none."""
    stated = re.findall(r'[`"]([\w.]+)[`"]', message.partition("(known: ")[0])
    for old in stated:
        found = {VALUES.get((key, old), old) for key in stated} | {
            ".".join(new_key(tuple(old.split(".")))),
            OUTCOMES.get(old, old),
        }
        if new := found - {old}:
            return f"; renamed to `{new.pop()}`: jax-aero rename FILE"
    return ""
