"""What a result has to say about itself: configuration, code, versions, machine; no path of this machine."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
import subprocess
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any

from jax_aero import places, rust

REPOSITORY, RESULTS = places.HOME, places.RESULTS


def build(
    name: str,
    config: Mapping[str, Any],
    flight: rust.FlightResult,
    *,
    overrides: Mapping[str, Any],
    command: str,
    wall_time: float,
) -> dict[str, Any]:
    """Return the manifest of one flight, ready for JSON."""
    return {
        "name": name,
        "title": config.get("title") or name,
        "outcome": flight.outcome,
        "lost_time": flight.lost_time,
        "lost_reason": flight.lost_reason,
        # JSON has no infinity, and the errors of a fall may be infinite.
        "summary": {key: value if math.isfinite(value) else None for key, value in flight.summary.items()},
        "config_digest": rust.config_digest(config),
        "config": portable(config),
        "overrides": portable(overrides),
        "seed": dict(seeds(config)) or None,
        "command": command,
        "engine": config.get("engine", "rust"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "wall_time_s": round(wall_time, 3),
        "git": git_state(),
        "versions": versions(),
        "device": device(),
    }


def portable(value: Any) -> Any:
    """Return `value` with absolute paths made relative to the repository, or cut to the bare name outside it."""
    if isinstance(value, Mapping):
        return {key: portable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [portable(item) for item in value]
    if isinstance(value, PurePath):
        value = str(value)
    if isinstance(value, str) and Path(value).is_absolute():
        path = Path(value)
        inside = path.is_relative_to(REPOSITORY)
        return path.relative_to(REPOSITORY).as_posix() if inside else f"(outside the repository)/{path.name}"
    return value


def seeds(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, int]]:
    """Yield every key called `seed`, with its dotted name."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from seeds(value, f"{prefix}{key}.")
        elif key == "seed" and isinstance(value, int):
            yield prefix + key, value


def git_state() -> dict[str, Any]:
    """Return commit and whether the working tree differs from it; nulls outside a git checkout."""
    if not places.IS_CHECKOUT:  # the package may be installed below a folder of another repository
        return {"commit": None, "dirty": None}
    commit = _git("rev-parse", "HEAD")
    changes = _git("status", "--porcelain")
    return {"commit": commit, "dirty": None if changes is None else bool(changes)}


def _git(*arguments: str) -> str | None:
    try:
        answer = subprocess.run(
            ["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()


def versions() -> dict[str, str]:
    """Return the versions a number in the result could depend on."""
    found = {"python": platform.python_version(), "flight-core": rust.__version__}
    for package in ("jax-aero", "numpy", "scipy", "xarray", "h5netcdf", "pyarrow"):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def device() -> dict[str, Any]:
    """Return processor and system, without the machine's name."""
    return {"cpu": _cpu_model(), "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}"}


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.processor() or "unknown")
