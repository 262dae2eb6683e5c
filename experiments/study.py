"""Studies: results that are no flight, such as a trim or an optimal trajectory. One folder each, like a flight's.

A study is configured by a TOML file of its own. Paths in it start at that file; every file named counts towards the
digest, so that an outdated result is recognised.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import xarray as xr

from experiments import Refused, manifest, record
from jax_aero import tables
from jax_aero.files import complete_folder, write_json

T = TypeVar("T")

RESULTS = manifest.RESULTS
CONFIGS = manifest.REPOSITORY / "configs"


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        return tables.read(path)
    except tables.ConfigError as reason:
        raise Refused(str(reason)) from None


def load(path: Path, kind: type[T], changes: Mapping[str, Any] | None = None) -> T:
    """Read a TOML file into its type, with some keys of the outermost table replaced."""
    try:
        return tables.load(path, kind, changes)
    except tables.ConfigError as reason:
        raise Refused(str(reason)) from None


def find(kind: str, name: str) -> Path:
    """Return the configuration of a study by its name, or by its path."""
    path = Path(name) if "/" in name or name.endswith(".toml") else CONFIGS / kind / f"{name}.toml"
    if not path.is_file():
        known = ", ".join(sorted(entry.stem for entry in (CONFIGS / kind).glob("*.toml")))
        raise Refused(f"no {kind} study `{name}`; there are {known}")
    return path


def schema_of(kind: str, folder: Path) -> str:
    """Return the path of the schema of a kind of file, from a folder."""
    return os.path.relpath(CONFIGS / "schema" / f"{kind}.schema.json", folder.resolve())


def digest(config: Mapping[str, Any], files: Sequence[Path]) -> str:
    """SHA-256 over a configuration and the files it names; the same on every machine."""
    total = hashlib.sha256(json.dumps(manifest.portable(config), sort_keys=True).encode())
    for file in files:
        total.update(file.read_bytes())
    return total.hexdigest()


def build_manifest(
    name: str,
    title: str,
    config: Mapping[str, Any],
    config_digest: str,
    *,
    summary: Mapping[str, Any],
    timings: Mapping[str, float],
    command: Sequence[str] | None = None,
    engine: str = "casadi",
) -> dict[str, Any]:
    """Return the manifest of a study, ready for JSON; `timings` are in seconds of wall time."""
    from importlib.metadata import version

    return {
        "name": name,
        "title": title,
        "summary": dict(summary),
        "config_digest": config_digest,
        "config": manifest.portable(config),
        "command": " ".join(str(manifest.portable(word)) for word in command or _command()),
        "engine": engine,
        "timings_s": {key: round(value, 4) for key, value in timings.items()},
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "git": manifest.git_state(),
        "versions": manifest.versions() | {engine: version(engine)},
        "device": manifest.device(),
    }


def _command() -> list[str]:
    # argv[0] is the path of the module that runs: `experiments.trim`, or `experiments`.
    module = Path(sys.argv[0]).stem
    return ["python", "-m", "experiments" if module == "__main__" else f"experiments.{module}", *sys.argv[1:]]


def write(
    folder: Path,
    dataset: xr.Dataset,
    document: Mapping[str, Any],
    texts: Mapping[str, str] | None = None,
) -> None:
    """Write a result folder at once, in the place of an older result; `texts` are further files by name."""
    texts = texts or {}
    if folder.exists() and (more := set(record.unrelated_files(folder)) - set(texts)):
        raise Refused(f"{manifest.portable(folder)} holds more than a result ({min(more)}), so it is not replaced")
    with complete_folder(folder, replace=True) as draft:
        record.write_dataset(dataset, draft / record.RUN_FILE)
        for name, text in texts.items():
            (draft / name).write_text(text, encoding="utf-8")
        write_json(draft / record.MANIFEST_FILE, document)
