"""Writes files and folders completely or not at all; they are on the disk when they appear.

Names of drafts are fixed, and whoever writes a folder or a sweep holds its lock: a draft that is found under the lock
was left by a process that was killed.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import shutil
import socket
import stat
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jax_aero.command import Refused


@contextmanager
def complete_file(target: Path) -> Iterator[Path]:
    """Yield a draft beside `target` that replaces it when the block ends, and is removed when the block raises."""
    target.parent.mkdir(parents=True, exist_ok=True)
    # In the same folder, so that the rename stays on one file system and is atomic.
    draft = target.with_name(f".{target.stem}.{os.getpid()}.draft{target.suffix}")
    try:
        yield draft
        _sync(draft)
        draft.replace(target)
        _sync(target.parent)
    except OSError as reason:
        raise OSError(reason.errno, reason.strerror, str(target)) from reason  # a full disk names no file
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def complete_folder(target: Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a draft folder that becomes `target` when the block ends, and is removed when the block raises.

    A process that was killed between the two renames of a replacement leaves the old folder under another name: the
    next one puts it back. Where `target` is a symbolic link, what it leads to is replaced.

    Raises
    ------
    Refused
        If another process writes the same folder.
    OSError
        If `target` is there without `replace`, or the disk is full.
    """
    target = target.resolve()
    draft, retired = (target.with_name(f".{target.name}.{word}") for word in ("draft", "old"))
    with locked(target):
        if retired.exists() and not target.exists():
            retired.rename(target)
        for left in (draft, retired):
            shutil.rmtree(left, ignore_errors=True)
        draft.mkdir()
        try:
            yield draft
            for path in [*draft.rglob("*"), draft]:
                _sync(path)
            if replace and target.exists():
                target.rename(retired)
            draft.rename(target)
            _sync(target.parent)
        except BaseException:
            if retired.exists() and not target.exists():
                retired.rename(target)
            raise
        finally:
            shutil.rmtree(draft, ignore_errors=True)
            shutil.rmtree(retired, ignore_errors=True)


@contextmanager
def locked(target: Path) -> Iterator[None]:
    """Hold the lock of a file or folder: `.NAME.lock` beside it, which names this process and goes with the block.

    The system frees a lock when its process ends, however it ends, and the next one takes it over. Only a lock of
    another machine is left alone: whether that process still runs is not known here.

    Raises
    ------
    Refused
        Naming process, machine and start of whoever holds it.
    """
    target = target.resolve()  # one lock, whatever link leads there
    target.parent.mkdir(parents=True, exist_ok=True)
    path = target.with_name(f".{target.name}.lock")
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _take(descriptor, path, target)
            if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
                break  # and not a file that its holder has removed since it was opened
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


def computing(target: Path) -> AbstractContextManager[None]:
    """Hold the lock of the work on a result: of what is computed, and kept beside it, before its folder is written."""
    return locked(target.resolve().with_name(f".{target.resolve().name}.work"))


def _take(descriptor: int, path: Path, target: Path) -> None:
    """Lock an open file and write into it who holds it."""
    here = socket.gethostname()
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        is_taken = False
    except BlockingIOError:
        is_taken = True
    try:
        holder = json.loads(os.pread(descriptor, 4096, 0))
        who = f"process {holder['pid']} on {holder['host']} since {holder['since']}"
        is_elsewhere = holder["host"] != here
    except (ValueError, KeyError, TypeError):  # its name is not there yet, or never will be
        who, is_elsewhere = "another process", False
    if is_taken or is_elsewhere:
        hint = f"; if that process has ended, remove {os.path.relpath(path)}" if is_elsewhere else ""
        raise Refused(f"{os.path.relpath(target)} is being written by {who}{hint}")
    me = {"pid": os.getpid(), "host": here, "since": datetime.now(UTC).isoformat(timespec="seconds")}
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(me).encode(), 0)


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def checksums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of a folder, by its path in it."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): _sha256(path) for path in paths}


def damaged(folder: Path, checksums: Mapping[str, str]) -> str | None:
    """Return the first file that is not what it was when its checksum was taken, or `None`."""

    def is_whole(name: str, checksum: str) -> bool:
        return (folder / name).is_file() and _sha256(folder / name) == checksum

    return next((name for name, checksum in checksums.items() if not is_whole(name, checksum)), None)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sealed(content: bytes, what: str) -> bytes:
    """Return a file's content behind the SHA-256 of it and of what it is."""
    return hashlib.sha256(what.encode() + content).digest() + content


def unsealed(file: bytes, what: str) -> bytes | None:
    """Return what was sealed, or `None` where it is empty, cut short, changed, or something else."""
    content = file[hashlib.sha256().digest_size :]
    return content if file == sealed(content, what) else None


MAX_SIZE = 64 * 1024 * 1024
"""Longest file that is read into memory [bytes], as in the crate."""


def read_bytes(path: Path, greatest: int = MAX_SIZE) -> bytes:
    """Read a regular file; a device, a pipe and what is longer than `greatest` [bytes] are refused unread."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > greatest:
        raise Refused(f"{path.name}: expected a regular file of at most {greatest} bytes")
    return path.read_bytes()


def read_text(path: Path, greatest: int = MAX_SIZE) -> str:
    """Read a text file in UTF-8, as `read_bytes`."""
    return read_bytes(path, greatest).decode()


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON document that is a table; a damaged one is refused by its name."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as reason:
        raise Refused(f"{path} is damaged: {reason}") from None
    if not isinstance(document, dict):
        raise Refused(f"{path} is damaged: it holds no table")
    return document


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file in one go; a disk that is full is an `OSError` and leaves what was there."""
    with complete_file(path) as draft:
        draft.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8."""
    write_bytes(path, text.encode())


def write_json(path: Path, document: Any) -> None:
    """Write a JSON document; NaN and infinity are refused with a `ValueError`, since JSON has neither."""
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def finite(value: Any) -> Any:
    """Return a value, or tables of values, for JSON: infinity, to which errors of a fall may grow, and NaN are none."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_netcdf(path: Path, dataset: Any, encoding: Any = None) -> None:
    """Write an xarray dataset as NetCDF-4. HDF5 works in memory, since it ends the process where a disk is full."""
    write_bytes(path, dataset.to_netcdf(engine="h5netcdf", encoding=encoding))
