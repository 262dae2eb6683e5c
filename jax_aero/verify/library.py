"""Comparison of the C library with the crate: the measurements of a flight, tick by tick, through `libflight`.

Both are compiled from one source, so the commands have the same bits. `rust/capi/include/flight.h` declares what stands
here again.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Iterator, Mapping
from ctypes import POINTER, Structure, c_char_p, c_double, c_size_t, c_uint32, c_void_p, sizeof
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero import backends, rust
from jax_aero.base import places, plain_values
from jax_aero.base.result import FlightResult
from jax_aero.base.terminal import Refused
from jax_aero.verify import Row, compare

COMMANDS = {"thrust_rate": "thrust_rate", "joint_velocity": "joint_velocity_command", "joint_torque": "joint_torque"}
"""Arrays of a command, and their signals."""

BUILD = "cargo build --release --package flight-capi"

Numbers = POINTER(c_double)


class _Header(Structure):
    _fields_ = (
        ("version", c_uint32),
        *((f"{name}_size", c_size_t) for name in ("measurement", "setpoint", "preview", "command")),
    )


class _Measurement(Structure):
    _fields_ = (
        ("time", c_double),
        ("base_position", c_double * 3),
        ("base_rotation", c_double * 9),
        ("base_velocity", c_double * 6),
        ("joint_position", Numbers),
        ("joint_velocity", Numbers),
        ("thrust", Numbers),
        ("wind", c_double * 3),
        ("foot_wrenches", Numbers),
        ("shaft_speed", Numbers),
        ("height", Numbers),
    )


class _Command(Structure):
    _fields_ = tuple((name, Numbers) for name in COMMANDS)


def find() -> Path | None:
    """Return the newest library that cargo has built in the clone, if any."""
    built = (places.HOME / "target").glob("*/**/libflight.so")
    return max(built, key=lambda path: path.stat().st_mtime, default=None)


def verify_library(config: Mapping[str, Any], path: Path) -> list[Row]:
    """Compare the commands of every tick of a flight."""
    flight = backends.backend(backends.backend_of(config)).fly(config)
    given = commands(config, flight, path)
    return [
        compare("C", name, np.array([command[name] for command in given]), flight[signal], 0.0)
        for name, signal in COMMANDS.items()
    ]


def why_not(config: Mapping[str, Any]) -> str | None:
    """Return why a log of this configuration has not all that its ticks are given, if so."""
    resolved = rust.resolve_config(config)
    if resolved["controller"]["torque"]["steps"] > 1:
        return "controller.torque.steps, whose joints no log has"
    if (resolved["simulator"].get("sensors") or {}).get("wind_preview"):
        return "simulator.sensors.wind_preview, which no log has"
    return "own_controller" if config.get("own_controller") else None


def commands(config: Mapping[str, Any], flight: FlightResult, path: Path) -> list[dict[str, Any]]:
    """Return the commands of the library for every measurement of a flight."""
    library, message = ctypes.CDLL(str(path)), ctypes.create_string_buffer(1000)
    create, tick = library.flight_controller_create, library.flight_tick
    create.restype, create.argtypes = c_void_p, (_Header, c_char_p, c_char_p, c_size_t)
    library.flight_start.argtypes = (c_void_p, POINTER(_Measurement), c_char_p, c_size_t)
    tick.argtypes = (c_void_p, POINTER(_Measurement), c_void_p, POINTER(_Command))
    library.flight_controller_free.argtypes = (c_void_p,)
    sizes = sizeof(_Measurement), 30 * sizeof(c_double), 6 * sizeof(c_void_p), sizeof(_Command)
    header = _Header(library.flight_version(), *sizes)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "flight.toml"
        file.write_text(plain_values.toml(config), encoding="utf-8")
        controller = create(header, bytes(file), message, len(message))
    if controller is None:
        raise Refused(f"{path}: {message.value.decode()}; expected the library of this version: {BUILD}")
    try:
        rows = list(_measurements(flight))
        if library.flight_start(controller, rows[0], message, len(message)):
            raise Refused(f"{path}: {message.value.decode()}")
        answers = []
        for row in rows:
            arrays = {name: np.empty(flight[signal].shape[1]) for name, signal in COMMANDS.items()}
            if status := tick(controller, row, None, _Command(*map(_pointer, arrays.values()))):
                raise Refused(f"{path}: a tick ends with status {status}")
            answers.append(arrays)
        return answers
    finally:
        library.flight_controller_free(controller)


def _measurements(flight: FlightResult) -> Iterator[_Measurement]:
    log = {name: np.ascontiguousarray(rows) for name, rows in flight.log.items()}
    parts = ("base_position", "base_rotation", "base_velocity", "joint_position", "joint_velocity", "thrust", "wind")
    for k, time in enumerate(log["time"]):
        raw = [log[f"raw_{name}"][k] for name in parts]
        raw += [log[name][k] if name in log else None for name in ("raw_foot_wrench", "raw_shaft_speed")]
        raw.append(log["raw_height"][k : k + 1])
        yield _Measurement(
            time,
            *(
                value if value is None else _pointer(value) if kind is Numbers else kind(*np.ravel(value))
                for value, (_, kind) in zip(raw, _Measurement._fields_[1:], strict=True)
            ),
        )


def _pointer(numbers: np.ndarray) -> Any:
    return numbers.ctypes.data_as(Numbers)
