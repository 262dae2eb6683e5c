"""Changes of a configuration, values by dotted key, as options `--set key=value` and in the name of a result's folder.

A flight, study, training or CFD design changed by `--set` has a separate result, `NAME--key=value` beside the unchanged
`NAME`, unless --name gives another name or --out another place.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jax_aero.base import places, plain_values


def folder_suffix(changes: Mapping[str, Any]) -> str:
    """Return the suffix of a folder name that distinguishes a changed run from the unchanged one.

    `{"wind.velocity": [0, -12, 0]}` becomes `--wind.velocity=0_-12_0`; long ones, and those with characters unsuited to
    folder names, end in a digest.
    """
    return places.addition("".join(f"--{key}={_flatten(value)}" for key, value in sorted(changes.items())))


def options_of(changes: Mapping[str, Any], named: str | None = None) -> list[str]:
    """Return the command line options that make these changes and give the result this name."""
    assignments = (f"{key}={plain_values.toml_value(value)}" for key, value in changes.items())
    words = [word for assignment in assignments for word in ("--set", assignment)]
    return words if named is None else [*words, "--name", named]


def _flatten(value: Any) -> str:
    if isinstance(value, Mapping):
        return "_".join(f"{key}={_flatten(item)}" for key, item in value.items())
    if isinstance(value, list):
        return "_".join(_flatten(item) for item in value)
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return places.file_name(Path(text).name if Path(text).is_absolute() else text)
