"""Files that a file names: the URDF of a robot, the `base` of a flight, the weights of a card."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from jax_aero.base import tables
from jax_aero.base.files import complete_folder, parse_json
from jax_aero.base.terminal import Refused


def named_files(path: Path) -> Iterator[Path]:
    """Yield a file and, recursively, every file that it names.

    In a TOML or JSON file, a text that is the path of a file relative to its folder counts as a name.
    """
    return _find_named(path.resolve(), set())


def file_hash(path: Path) -> str:
    """Return a hash of a file and of every file that it names, wherever they are.

    Of TOML and JSON it is of what they say: comments, layout and the order of keys do not count.
    """
    total = hashlib.sha256()
    for file in named_files(path):
        said = _table(file)
        content = file.read_bytes() if said is None else json.dumps(said, sort_keys=True).encode()
        total.update(hashlib.sha256(content).digest())
    return total.hexdigest()


def copy_named(path: Path, out: Path, *, replace: bool = False) -> Path:
    """Copy a file with every file that it names into a folder, laid out as they are; return the copy of the file.

    Raises
    ------
    Refused
        If one is named by a place outside the folder that they share, as by an absolute path.
    """
    files = list(named_files(path))
    root = Path(os.path.commonpath([file.parent for file in files]))
    with complete_folder(out, replace=replace) as draft:
        copies = [draft / file.relative_to(root) for file in files]
        for file, copy in zip(files, copies, strict=True):
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy)
        if missing := {*named_files(copies[0])} ^ {copy.resolve() for copy in copies}:
            raise Refused(f"`{path}` names {missing.pop()} by an absolute path; expected one relative to its folder")
    return out / copies[0].relative_to(draft)


def _find_named(path: Path, seen: set[Path]) -> Iterator[Path]:
    if path in seen:
        return
    seen.add(path)
    yield path
    for text in _texts(_table(path)):
        if os.path.isfile(path.parent / text):  # noqa: PTH113 - `Path` raises for texts too long for a name
            yield from _find_named((path.parent / text).resolve(), seen)


def _table(path: Path) -> Any:
    """Return what a TOML or JSON file says; `None` for other files, and damaged ones, which their user will report."""
    state = path.stat()
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def _read(path: Path, *_: int) -> Any:
    """Return what a file says that was changed at this time, and is of this size."""
    try:
        if path.suffix.lower() == ".toml":
            return tables.read(path)
        return parse_json(path.read_bytes()) if path.suffix.lower() == ".json" else None
    except ValueError:
        return None


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(part)
