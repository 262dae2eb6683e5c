"""`--set key=value`: from the command line to values, and to the name of a folder."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Any

from jax_aero.keys import parse_assignments as parse

__all__ = ["folder_suffix", "parse"]

SUFFIX_LENGTH = 100


def folder_suffix(overrides: Mapping[str, Any]) -> str:
    """Return what distinguishes a run with overrides from the plain one, fit for a folder name.

    `{"wind.velocity": [0, -12, 0]}` becomes `--wind.velocity=0_-12_0`; long ones end in a digest.
    """
    suffix = "".join(f"--{key}={_flat(value)}" for key, value in sorted(overrides.items()))
    if len(suffix) <= SUFFIX_LENGTH:
        return suffix
    digest = hashlib.sha256(suffix.encode()).hexdigest()[:8]
    return f"{suffix[: SUFFIX_LENGTH - 9]}~{digest}"


def _flat(value: Any) -> str:
    if isinstance(value, Mapping):
        return "_".join(f"{key}={_flat(item)}" for key, item in value.items())
    if isinstance(value, list):
        return "_".join(_flat(item) for item in value)
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return re.sub(r"[^\w.+=-]", "-", text)
