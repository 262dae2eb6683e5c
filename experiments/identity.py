"""What a local result is of: its configuration, the files that it names, and the code that makes it. One rule for all.

A result of another identity is refused: by the command that makes it without --overwrite, by report and figures
(`experiments.outdated`) without --stale; and unfinished work of another identity is not resumed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.sources import code_hash, file_hash
from jax_aero.base.typed import make_portable

ANOTHER = "another configuration"


@dataclass(frozen=True)
class Identity:
    """What a result is of; equal on every machine."""

    digest: str
    """Digest of the configuration and of the files that it names."""
    modules: tuple[str, ...]
    """Modules whose code, with all that they import, makes the result."""

    @classmethod
    def of(cls, config: Mapping[str, Any], modules: Sequence[str], files: Iterable[Path] = ()) -> Identity:
        """Return the identity of a configuration, and of files with those that they name."""
        text = json.dumps([make_portable(config), [file_hash(file) for file in files]], sort_keys=True)
        return cls(hashlib.sha256(text.encode()).hexdigest(), tuple(modules))

    @property
    def code(self) -> str:
        """Return the hash of the code."""
        return code_hash(*self.modules)

    def __str__(self) -> str:
        """Return the mark of unfinished work."""
        return f"{self.digest} {self.code}"

    @property
    def facts(self) -> dict[str, Any]:
        """Return the entries of a manifest by which the result is recognised."""
        return {"config_digest": self.digest, "code_hash": self.code, "modules": list(self.modules)}

    def difference(self, manifest: Mapping[str, Any]) -> str:
        """Return what a result was made of instead, by its manifest; empty if it is this one."""
        if manifest.get("config_digest") != self.digest:
            return ANOTHER
        return "" if manifest.get("code_hash") == self.code else other_code(manifest)


def other_code(manifest: Mapping[str, Any]) -> str:
    """Return "other code", with the commit of a result if it is known."""
    commit = (manifest.get("git") or {}).get("commit")
    return f"other code (commit {commit[:10]})" if commit else "other code"
