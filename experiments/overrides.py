"""`--set key=value`: from the command line to values, and to the name of a folder."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from experiments import Refused

BARE_WORD = re.compile(r"[A-Za-z_./][\w./-]*")
SUFFIX_LENGTH = 100


def parse(assignments: Iterable[str]) -> dict[str, Any]:
    """Read `key=value` texts; a value is written as in TOML, and a bare word is a text."""
    return dict(_parse_one(assignment) for assignment in assignments)


def _parse_one(assignment: str) -> tuple[str, Any]:
    key, equals, text = (part.strip() for part in assignment.partition("="))
    if not equals or not all(key.split(".")):
        raise Refused(f"--set {assignment}: expected key=value, e.g. wind.velocity=[0,-12,0]")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError as reason:
        # A shell strips quotes, so `simulator.lever_arm=unrotated` has to work as it stands.
        if BARE_WORD.fullmatch(text) is None:
            raise Refused(f"--set {assignment}: `{text}` is no TOML value ({reason})") from None
        value = text
    return key, value


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
