"""What a result is of: its configuration with the files that it names, and versions of the numbers that made it.

A result of another identity is refused: by the command that makes it without --overwrite, by report and figures
(`outdated`) without --stale; and unfinished work of another identity is not resumed. Comments, help, layout
and docstrings change no identity.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base import numerics
from jax_aero.base.references import file_hash
from jax_aero.base.typed_config import make_portable

ANOTHER = "another configuration"

CRATE, PYTHON = "crate", "jax_aero"
VERSIONS = {CRATE: rust.NUMERICS, PYTHON: numerics.NUMERICS}
"""Versions of the numbers of what computes."""


def computed_by(backend: str) -> tuple[str, ...]:
    """Return what computes a flight of an backend."""
    return (CRATE,) if backend == "rust" else (CRATE, PYTHON)


@dataclass(frozen=True)
class Identity:
    """What a result is of; equal on every machine."""

    digest: str
    """Digest of the configuration and of the files that it names."""
    computed_by: Sequence[str] = (CRATE, PYTHON)
    """What computes the result, of `VERSIONS`."""

    @classmethod
    def of(
        cls, config: Mapping[str, Any], files: Iterable[Path] = (), computed_by: Sequence[str] = (CRATE, PYTHON)
    ) -> Identity:
        """Return the identity of a configuration, and of files with those that they name."""
        text = json.dumps([make_portable(config), [file_hash(file) for file in files]], sort_keys=True)
        return cls(hashlib.sha256(text.encode()).hexdigest(), computed_by)

    @property
    def numerics(self) -> dict[str, int]:
        """Return the versions of the numbers."""
        return {name: VERSIONS[name] for name in self.computed_by}

    def __str__(self) -> str:
        """Return the mark of unfinished work."""
        return f"{self.digest} {self.numerics}"

    @property
    def facts(self) -> dict[str, Any]:
        """Return the entries of a manifest by which the result is recognised."""
        return {"config_digest": self.digest, "numerics": self.numerics}

    def difference(self, manifest: Mapping[str, Any]) -> str:
        """Return what a result was made of instead, by its manifest; empty if it is this one."""
        return other_numerics(manifest) if manifest.get("config_digest") == self.digest else ANOTHER


def numerics_of(manifest: Mapping[str, Any]) -> dict[str, int]:
    """Return the versions of the numbers of a result; the first of one from before there were any, which names none."""
    first = dict.fromkeys(computed_by(manifest.get("backend", "rust")), 1)
    return dict(manifest.get("numerics") or first)


def other_numerics(manifest: Mapping[str, Any]) -> str:
    """Return which versions of the numbers a result has instead of today's, with its commit; empty if it has those."""
    others = [
        f"{name} {version} instead of {VERSIONS.get(name)}"
        for name, version in numerics_of(manifest).items()
        if version != VERSIONS.get(name)
    ]
    if not others:
        return ""
    commit = (manifest.get("git") or {}).get("commit")
    return f"other numerics ({', '.join([*others, *([f'commit {commit[:10]}'] if commit else [])])})"
