"""Compiled programs, kept in the user's cache folder for the next process.

JAX's own setting goes first: with `JAX_COMPILATION_CACHE_DIR`, or `jax.config.jax_compilation_cache_dir` set before the
first flight is prepared, programs are kept there; with `JAX_ENABLE_COMPILATION_CACHE=false` nowhere.
"""

from __future__ import annotations

import hashlib
import os
import platform
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax


def _processor() -> str:
    """Return what distinguishes processors, for which XLA compiles: a program of another one may not run on this."""
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8", errors="replace").splitlines() if cpu.is_file() else []
    features = next((line for line in lines if line.startswith(("flags", "Features"))), platform.processor())
    return f"{platform.machine()}-{hashlib.sha256(features.encode()).hexdigest()[:8]}"


def keep_programs() -> None:
    """Let JAX keep all that it compiles, unless the user has said where or nothing can be kept."""
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        with suppress(OSError, RuntimeError):  # `Path.home` raises the latter for a user without a home
            root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
            folder = root / "jax-aero" / _processor()
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                config.update("jax_compilation_cache_dir", str(folder))
                config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
