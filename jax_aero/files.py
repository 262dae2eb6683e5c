"""Files and folders that appear completely or not at all."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def complete_file(target: Path) -> Iterator[Path]:
    """Yield a draft beside `target` that replaces it when the block ends, and is removed when the block raises."""
    target.parent.mkdir(parents=True, exist_ok=True)
    # In the same folder, so that the rename stays on one file system and is atomic.
    draft = target.with_name(f".{target.stem}.{os.getpid()}.draft{target.suffix}")
    try:
        yield draft
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def complete_folder(target: Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a draft folder that becomes `target` when the block ends, and is removed when the block raises."""
    target.parent.mkdir(parents=True, exist_ok=True)
    draft = target.with_name(f".{target.name}.{os.getpid()}.draft")
    retired = target.with_name(f".{target.name}.{os.getpid()}.old")
    draft.mkdir()
    try:
        yield draft
        if replace and target.exists():
            target.rename(retired)
        draft.rename(target)
    except BaseException:
        if retired.exists() and not target.exists():
            retired.rename(target)
        raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        shutil.rmtree(retired, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with complete_file(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_json(path: Path, document: Any) -> None:
    """Write a JSON document; NaN and infinity are refused with a `ValueError`, since JSON has neither."""
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
