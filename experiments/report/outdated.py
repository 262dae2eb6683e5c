"""Detection of results made with a configuration that differs from the present one of their name.

The digest of a result shows whether it differs, and its stored configuration which keys; if no key differs, a file
named in it does. A name that is not shipped, such as that of a user's file, is not checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from experiments import manifest
from experiments.cfd.settings import FlowConfig
from experiments.sources import file_hash
from experiments.sweep import run, spec
from experiments.sweep.design import Design
from jax_aero import rust
from jax_aero.base import places, plain, tables

MOST = 4
"""Greatest number of differing keys that are named."""

WITH_FILES = {"cfd_flow": FlowConfig}
"""Types of the report's studies whose configurations are files of `configs/KIND/`."""


def flight(name: str, digest: str | None, kept: Mapping[str, Any] | None) -> str:
    """Return the difference from the experiment of this name; empty if there is none.

    A result has the digest of the configuration that was flown, and usually the configuration (`kept`).
    """
    if name not in places.names("experiments"):
        return ""
    today = rust.load_config(places.find("experiments", name))
    if rust.config_digest(today) == digest:
        return ""
    if kept is None:
        return "its configuration"
    return _list_keys(_differing_keys(kept, manifest.make_portable(today))) or "a file that it names"


def sweep(name: str, document: Mapping[str, Any]) -> str:
    """Return the difference of a result's description from the sweep of this name; empty if there is none."""
    if name not in places.names("sweeps"):
        return ""
    today = spec.load(name)
    if Design(today).digest == document.get("config_hash"):
        return ""
    described = run.describe(today)
    kept = {key: document.get(key) for key in described}
    return _list_keys(_differing_keys(kept, described)) or "the flights of its cells, or a file that they name"


def study(kind: str, name: str, document: Mapping[str, Any]) -> str:
    """Return the difference of a study's manifest in configuration, flights and files; empty if there is none."""
    config, sources = document.get("config", {}), document.get("sources")
    if sources is None:
        return "it does not say which flights and files it was made of"
    found = []
    if kind in WITH_FILES and name in places.names(kind):
        today = plain.to_builtins(tables.load(places.find(kind, name), WITH_FILES[kind]))
        found.append(_list_keys(_differing_keys(config, manifest.make_portable(today))))
    for one, digest in sources["flights"].items():
        differs = flight(one, digest, sources.get("configurations", {}).get(one))
        found.append(f"{one}: {differs}" if differs else "")
    for path, digest in sources["files"].items():
        file = places.HOME / path
        found.append(path if file.is_file() and file_hash(file) != digest else "")
    return "; ".join(filter(None, found))


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
