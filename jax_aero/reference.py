"""The Rust crate as a Python library: NumPy in, NumPy out, SI and radians.

The only importer of the compiled module `jax_aero._core`.

>>> from jax_aero import reference
>>> config = reference.load_config("configs/experiments/test2.toml", {"simulator.duration": 1.0})
>>> flight = reference.fly(config)
>>> flight["thrust"].shape[1]
4
"""

from __future__ import annotations

import copy
import difflib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from jax_aero import _core
from jax_aero._core import Robot, __version__

if TYPE_CHECKING:
    from jax_aero._core import _Flight

__all__ = [
    "Config",
    "Flight",
    "Robot",
    "__version__",
    "check_config",
    "config_digest",
    "config_keys",
    "fly",
    "fly_batch",
    "load_config",
]

Config = dict[str, Any]
"""A resolved flight configuration: nested tables of plain values, every default written out."""

PATH_KEYS = ("robot", "path")
"""Keys whose value is a path, as the crate knows them."""

Progress = Callable[[int, int], None]
"""Called with (ticks flown, ticks in all)."""


@dataclass(frozen=True)
class Flight:
    """One flight: its log and how it ended.

    Attributes
    ----------
    log
        Signal name to array; the first axis is time. `experiments/record.py` names every signal, with its unit.
    joint_reference
        Posture of the first tick, which the controller keeps pulling towards [rad].
    outcome
        "completed", or "fell" when the simulator's fall criterion was met.
    fall_time, fall_reason
        When [s] and by which criterion; `None` for a completed flight.
    summary
        Extremes of the flight, as the crate computes them.
    """

    log: Mapping[str, NDArray[np.float64]]
    joint_reference: NDArray[np.float64]
    outcome: Literal["completed", "fell"]
    fall_time: float | None
    fall_reason: str | None
    summary: Mapping[str, float]

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        return self.log[signal]

    @classmethod
    def _from_core(cls, raw: _Flight) -> Flight:
        return cls(
            log=raw["log"],
            joint_reference=raw["joint_reference"],
            outcome=raw["outcome"],
            fall_time=raw["fall_time"],
            fall_reason=raw["fall_reason"],
            summary=raw["summary"],
        )


def load_config(path: str | PathLike[str], overrides: Mapping[str, Any] | None = None) -> Config:
    """Read a flight configuration, merge the files it builds on, apply overrides, check it.

    Parameters
    ----------
    path
        A TOML file such as `configs/experiments/test2.toml`.
    overrides
        Dotted key to value, e.g. `{"wind.velocity": [0, -12, 0]}`. A key has to exist in the
        resolved configuration, or at least be one the crate accepts.

    Raises
    ------
    ValueError
        Naming the file or key, the value and what was expected.
    """
    config: Config = json.loads(_core.resolve_config(fspath(path)))
    check_config(config)
    return _with_overrides(config, overrides) if overrides else config


def check_config(config: Mapping[str, Any]) -> None:
    """Raise `ValueError`, naming key, value and expectation, unless this configuration can fly."""
    _core.check_config(_to_json(config))


def config_digest(config: Mapping[str, Any]) -> str:
    """SHA-256 over the configuration and the robot's files, the same on every machine."""
    return _core.config_digest(_to_json(config))


def fly(config: Mapping[str, Any], progress: Progress | None = None) -> Flight:
    """Fly one configuration from start to end, or to the fall. Ctrl-C interrupts it."""
    return Flight._from_core(_core.fly(_to_json(config), progress))


def fly_batch(
    configs: Iterable[Mapping[str, Any]],
    threads: int | None = None,
    progress: Progress | None = None,
    *,
    full_log: bool = False,
) -> list[Flight]:
    """Fly many configurations over threads; the results do not depend on how many.

    Without `full_log` only outcome and summary are sure to be there.
    """
    texts = [_to_json(config) for config in configs]
    return [Flight._from_core(raw) for raw in _core.fly_batch(texts, threads, progress, full_log)]


def config_keys(config: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield every dotted key of a configuration, tables included."""
    for name, value in config.items():
        yield prefix + name
        if isinstance(value, Mapping):
            yield from config_keys(value, f"{prefix}{name}.")


def _with_overrides(config: Config, overrides: Mapping[str, Any]) -> Config:
    """Return a checked copy of `config` with these dotted keys changed."""
    changed = copy.deepcopy(config)
    for key, value in overrides.items():
        _set(changed, key, value)
    try:
        check_config(changed)  # all together: a ramp may move as a whole, past its old end
    except ValueError as reason:
        known = set(config_keys(config))
        for key in overrides:
            if key not in known:
                _refuse_unknown(config, key, overrides[key])
        listed = ", ".join(f"`{key}` = {value!r}" for key, value in overrides.items())
        raise ValueError(f"cannot set {listed}: {reason}") from None
    return changed


def _set(config: Config, key: str, value: Any) -> None:
    *parents, name = key.split(".")
    table = config
    for depth, parent in enumerate(parents, start=1):
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise ValueError(f"cannot set `{key}`: `{'.'.join(parents[:depth])}` is a value ({table!r}), not a table")
    # In a file a path starts at that file; here there is none, so it starts at the current folder.
    table[name] = str(Path(value).resolve()) if name in PATH_KEYS and isinstance(value, str) else value


def _refuse_unknown(config: Config, key: str, value: Any) -> None:
    """Raise for a key that is not in `config` and that the crate does not accept on its own either."""
    alone = copy.deepcopy(config)
    _set(alone, key, value)
    try:
        check_config(alone)
    except ValueError as reason:
        raise ValueError(f"unknown key `{key}`{_suggestion(config, key)} ({reason})") from None


def _suggestion(config: Config, key: str) -> str:
    """Name the keys that were probably meant: a near miss, or the same last word elsewhere."""
    keys = list(config_keys(config))
    near = difflib.get_close_matches(key, keys, n=3, cutoff=0.75)
    near += [k for k in keys if k.rsplit(".", 1)[-1] == key.rsplit(".", 1)[-1] and k not in near]
    if not near:
        near = difflib.get_close_matches(key, keys, n=2, cutoff=0.5)
    return f"; did you mean {' or '.join(f'`{k}`' for k in near[:3])}?" if near else ""


def _to_json(config: Mapping[str, Any]) -> str:
    try:
        return json.dumps(config, allow_nan=False)
    except (TypeError, ValueError) as reason:
        raise ValueError(f"the configuration holds a value that is no number, text, list or table: {reason}") from None
