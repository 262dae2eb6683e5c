"""What differs between a local result and today's of its name: configuration, files, numerics (`identity`).

If the configuration differs, its keys are named; if no key differs, a file named in it does. A sweep names its file;
a flight whose name is not shipped, such as that of a user's file, is checked by the versions of its numbers alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base import documents, kinds, places, plain_values, tables
from jax_aero.base.files import read_json
from jax_aero.base.references import file_hash
from jax_aero.base.terminal import Refused
from jax_aero.cfd.settings import FlowConfig
from jax_aero.results import manifest
from jax_aero.results.identity import other_numerics

ANOTHER = "made of another configuration or numerics than today's"
"""What a result is, followed by the difference."""
MOST = 4
"""Greatest number of differing keys that are named."""

WITH_FILES = {"cfd_flow": FlowConfig}
"""Types of the report's studies whose configurations are files of `configs/KIND/`."""


def result(kind: str, folder: Path) -> str:
    """Return the difference of a result: of a `flight`, of `sweeps` or a kind of study; empty if there is none."""
    try:
        document = read_json(folder / kinds.find(kind).manifest, documents.Manifest)
    except Refused:
        return "no manifest that says what it was made of"
    if kind == "sweeps":
        return sweep(folder, document)
    return flight(folder.name, document) if kind == "flight" else study(kind, folder.name, document)


def flight(name: str, document: Mapping[str, Any]) -> str:
    """Return the difference of a flight's manifest from the experiment of this name, or else in numerics."""
    if document.get("overrides"):  # beside that of the experiment, as with --out
        return other_numerics(document)
    return _configuration(name, document.get("config_digest"), document.get("config")) or other_numerics(document)


def sweep(folder: Path, document: Mapping[str, Any]) -> str:
    """Return the difference of a result's description from its file, or the sweep of its name, or else in numerics."""
    shipped = places.folder_of("sweeps") / f"{folder.name}.toml"
    file = folder / (document.get("file") or "")
    if (file := file if file.is_file() else shipped).is_file():
        # Sweeps need pyarrow, which the extra of figures does not bring.
        from jax_aero.sweep import run, spec
        from jax_aero.sweep.design import Design

        try:
            today = spec.load(str(file))
            digest = Design(today).digest
        except Refused as reason:
            return str(reason)
        if digest != document.get("config_digest"):
            described = run.describe(today)
            kept = {key: document.get(key) for key in described}
            return _list_keys(_differing_keys(kept, described)) or "the flights of its cells, or a file that they name"
    return other_numerics(document)


def study(kind: str, name: str, document: Mapping[str, Any]) -> str:
    """Return the difference of a study's manifest in configuration, flights, files and numerics."""
    config, sources = document.get("config", {}), document.get("sources")
    if sources is None:  # of trainings and CFD, whose data are no part of this project
        return other_numerics(document)
    differences = []
    if kind in WITH_FILES and name in places.names(kind):
        today = plain_values.to_builtins(tables.load(places.find(kind, name), WITH_FILES[kind]))
        differences.append(_list_keys(_differing_keys(config, manifest.make_portable(today))))
    for one, digest in sources["flights"].items():
        differs = _configuration(one, digest, sources.get("configurations", {}).get(one))
        differences.append(f"{one}: {differs}" if differs else "")
    for path, digest in sources["files"].items():
        file = places.HOME / path
        differences.append(path if file.is_file() and file_hash(file) != digest else "")
    return "; ".join(filter(None, differences)) or other_numerics(document)


def _configuration(name: str, digest: str | None, kept: Mapping[str, Any] | None) -> str:
    """Return the difference of the configuration that was flown, with its digest, from the experiment of this name."""
    if name not in places.names("experiments"):
        return ""
    today = rust.load_config(places.find("experiments", name))
    if rust.config_digest(today) == digest:
        return ""
    if kept is None:
        return "its configuration"
    return _list_keys(_differing_keys(kept, manifest.make_portable(today))) or "a file that it names"


def _differing_keys(kept: Mapping[str, Any], today: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys whose values differ."""
    for key in sorted(kept.keys() | today.keys()):
        one, other = kept.get(key), today.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            yield from _differing_keys(one, other, f"{prefix}{key}.")
        elif one != other:
            yield prefix + key


def _list_keys(keys: Iterator[str]) -> str:
    first = [f"`{key}`" for key in keys]
    more = [f"{len(first) - MOST} more"] if len(first) > MOST else []
    return ", ".join(first[:MOST] + more)
