"""Record of how a result was made: configuration, code, versions, machine; without paths of this machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shlex
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.files import replace_infinite
from jax_aero.base.typed_config import make_portable as make_portable
from jax_aero.results.identity import Identity


def build(
    name: str,
    title: str,
    config: Mapping[str, Any],
    identity: Identity,
    *,
    summary: Mapping[str, Any],
    command: Sequence[str],
    backend: str,
    **more: Any,
) -> dict[str, Any]:
    """Return the manifest of one result, ready for JSON; `more` are entries specific to its kind."""
    return {
        "name": name,
        "title": title,
        "summary": replace_infinite(summary),
        "config": make_portable(config),
        **identity.facts,
        "command": shlex.join(map(_portable_word, command)),
        "backend": backend,
        **more,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "git": git_state(),
        "versions": versions(backend),
        "device": device(),
    }


def version_of(package: str) -> dict[str, str]:
    """Return the version of a package by its name; empty if it is not installed."""
    try:
        return {package: importlib.metadata.version(package)}
    except importlib.metadata.PackageNotFoundError:
        return {}


def _portable_word(word: str) -> str:
    """Return a word of a command line with portable paths, also within `--set KEY="PATH"`; what is no text is `?`."""
    word = word.encode(errors="replace").decode()
    return re.sub(r"(^|[=\"'\[{,]\s*)(/[^\"',\]}]*)", lambda match: match[1] + str(make_portable(match[2])), word)


def seeds(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, int]]:
    """Yield every key called `seed`, with its dotted name."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from seeds(value, f"{prefix}{key}.")
        elif key == "seed" and isinstance(value, int):
            yield prefix + key, value


def git_state() -> dict[str, Any]:
    """Return the commit and whether the working tree differs from it; nulls outside a git checkout."""
    if not places.IS_CHECKOUT:  # the package may be installed below a folder of another repository
        return {"commit": None, "dirty": None}
    commit = _git("rev-parse", "HEAD")
    changes = _git("status", "--porcelain")
    return {"commit": commit, "dirty": None if changes is None else bool(changes)}


def _git(*arguments: str) -> str | None:
    try:
        # Without a lock, which a killed process would leave behind and which could make a concurrent commit fail.
        command = ["git", "--no-optional-locks", *arguments]
        answer = subprocess.run(command, cwd=places.HOME, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()


def versions(backend: str) -> dict[str, str]:
    """Return the versions that a result may depend on, including that of the backend's package."""
    stated = {"python": platform.python_version(), "flight-core": rust.__version__}
    for package in ("jax-aero", "numpy", "scipy", "xarray", "h5netcdf", "pyarrow"):
        stated |= version_of(package) or {package: "not installed as a package"}
    return stated | version_of(backend)


def processors() -> int:
    """Return the number of processors of this process's job, which may be fewer than those of the machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def device() -> dict[str, Any]:
    """Return processor and system, without the name of the machine."""
    return {"cpu": _cpu_model(), "cores": processors(), "system": f"{platform.system()} {platform.machine()}"}


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    models = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.processor() or "unknown")
