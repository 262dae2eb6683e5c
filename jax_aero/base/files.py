"""Atomic writing of files and folders: they appear completely or not at all, and are then on the disk. Bounded reading.

Drafts of folders have fixed names, and a process that writes a folder or a sweep holds its lock. A draft found under
the lock is therefore left over from a process that was killed.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import shutil
import socket
import stat
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from jax_aero.base import sizes
from jax_aero.base.terminal import Refused

try:
    import fcntl

    HAS_LOCKS = True
except ModuleNotFoundError:  # Windows
    HAS_LOCKS = False

WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)
"""Errors of file systems that have no locks."""


RENEWAL, STALE = 30.0, 180.0
"""Time after which a lock is renewed, and without that does not count on another machine [s]."""


@contextmanager
def complete_file(target: Path) -> Iterator[Path]:
    """Yield a draft beside `target` that replaces it when the block ends, and is removed when the block raises."""
    target.parent.mkdir(parents=True, exist_ok=True)
    # In the same folder, so that the rename stays within one file system and is atomic.
    draft = target.with_name(f".{target.stem}.{os.getpid()}.draft{target.suffix}")
    try:
        yield draft
        _sync(draft)
        draft.replace(target)
        _sync(target.parent)
    except OSError as reason:
        raise OSError(reason.errno, reason.strerror, str(target)) from reason  # the error of a full disk names no file
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def complete_folder(target: Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a draft folder that becomes `target` when the block ends, and is removed when the block raises.

    If a process is killed between the two renames of a replacement, the old folder remains under another name, and the
    next process restores it. If `target` is a symbolic link, the folder that it leads to is replaced.

    Raises
    ------
    Refused
        If another process is writing the same folder.
    OSError
        If `target` exists and `replace` is false, or if the disk is full.
    """
    target = resolve(target)
    draft, retired = (target.with_name(f".{target.name}.{word}") for word in ("draft", "old"))
    with lock(target):
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
def lock(target: Path) -> Iterator[None]:
    """Hold the lock of a file or folder for the duration of the block: `.NAME.lock` beside it, naming this process.

    The system releases a lock when its process ends for any reason, and the next process takes it over. A lock of
    another machine, where that is unknown, counts as long as it is renewed. On Windows none is held.

    Raises
    ------
    Refused
        If another process holds the lock; the message names its process, machine and start.
    """
    target = resolve(target)  # one lock for all links to the target
    target.parent.mkdir(parents=True, exist_ok=True)
    if not HAS_LOCKS:
        yield
        return
    path = target.with_name(f".{target.name}.lock")
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError:
            if not path.exists():
                raise
            whose = f"{os.path.relpath(path)} is a lock of user {path.stat().st_uid}"
            raise Refused(f"{whose}, who removes it if none of their commands runs; or choose another --out") from None
        try:
            _take(descriptor, path, target)
            if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
                break  # and not removed by its holder since it was opened
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    done = threading.Event()
    renewal = threading.Thread(target=_renew, args=(descriptor, done), daemon=True)
    renewal.start()
    try:
        yield
    finally:
        done.set()
        renewal.join()
        path.unlink(missing_ok=True)
        os.close(descriptor)


def _renew(descriptor: int, done: threading.Event) -> None:
    """Renew an open lock until it is done."""
    while not done.wait(RENEWAL):
        os.utime(descriptor)


def lock_work(target: Path) -> AbstractContextManager[None]:
    """Hold the lock for computing a result, which covers intermediate files beside it before its folder is written."""
    target = resolve(target)
    return lock(target.with_name(f".{target.name}.work"))


def resolve(target: Path) -> Path:
    """Return the absolute path that symbolic links lead to; refuse links that lead to one another."""
    try:
        return target.resolve()
    except RuntimeError:
        raise Refused(f"{target} is a symbolic link that leads to itself") from None


def _take(descriptor: int, path: Path, target: Path) -> None:
    """Lock an open lock file and write the holder into it."""
    here, is_taken = socket.gethostname(), _is_taken(descriptor, path)
    try:
        holder = parse_json(os.pread(descriptor, 4096, 0))
        who = f"process {holder['pid']} on {holder['host']} since {holder['since']}"
        is_elsewhere = holder["host"] != here
    except (ValueError, KeyError, TypeError):  # the holder has not been written
        who, is_elsewhere = "another process", False
    age = time.time() - os.fstat(descriptor).st_mtime
    if is_taken or (is_elsewhere and age < STALE):
        hint = f"; if that process has ended, wait {STALE - age:.0f} s or remove {os.path.relpath(path)}"
        raise Refused(f"{os.path.relpath(target)} is being written by {who}{hint if is_elsewhere else ''}")
    if is_elsewhere:
        what = f"{os.path.relpath(path)} of {who} was not renewed for {age / 60.0:.0f} minutes"
        warnings.warn(f"{what}, and is taken over", stacklevel=2)
    me = {"pid": os.getpid(), "host": here, "since": datetime.now(UTC).isoformat(timespec="seconds")}
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(me).encode(), 0)


def _is_taken(descriptor: int, path: Path) -> bool:
    """Lock an open file; return whether another process holds its lock. Where there are no locks, none is held."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as reason:
        if reason.errno not in WITHOUT_LOCKS:
            raise
        what = f"the file system of {path.parent} has no locks ({reason.strerror})"
        warnings.warn(f"{what}; expected that no other command writes {path.name[1:-5]} meanwhile", stacklevel=2)
    return False


def _sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk; Windows flushes nothing that is open for reading."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def checksums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a folder, by relative path."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): _sha256(path) for path in paths}


def find_damaged(folder: Path, checksums: Mapping[str, str]) -> str | None:
    """Return the first file that differs from its checksum, or `None`."""

    def is_whole(name: str, checksum: str) -> bool:
        return (folder / name).is_file() and _sha256(folder / name) == checksum

    return next((name for name, checksum in checksums.items() if not is_whole(name, checksum)), None)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def seal(content: bytes, what: str) -> bytes:
    """Return the content of a file, preceded by the SHA-256 of the content and its kind `what`."""
    return hashlib.sha256(what.encode() + content).digest() + content


def unseal(file: bytes, what: str) -> bytes | None:
    """Return content written by `seal`, or `None` if it is empty, truncated, changed or of another kind."""
    content = file[hashlib.sha256().digest_size :]
    return content if file == seal(content, what) else None


MAX_SIZE = 64 * 1024 * 1024
"""Greatest size of a file that is read into memory [bytes], as in the crate."""


def read_bytes(path: Path, greatest: int = MAX_SIZE) -> bytes:
    """Read a regular file; devices, pipes and files larger than `greatest` [bytes] are refused without reading."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > greatest:
        raise Refused(f"{path.name}: expected a regular file of at most {greatest} bytes")
    return path.read_bytes()


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, with the limits of `read_bytes`."""
    return read_bytes(path).decode()


MAX_DEPTH = 64
"""Greatest depth of lists and tables within each other in a document: ours have ten, and Python recurses a thousand."""


TOO_DEEP = f"lists and tables are more than {MAX_DEPTH} deep"


def parse_json(content: bytes) -> Any:
    """Parse JSON; raise `ValueError` if it is invalid, deeper than `MAX_DEPTH`, or has too many values."""
    sizes.expect("values", sum(map(content.count, (b",", b"[", b"{"))), sizes.MAX_OBJECTS)
    try:
        document = msgspec.json.decode(content)
    except msgspec.MsgspecError as reason:
        raise ValueError(str(reason)) from None
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    check_depth(document)
    return document


def check_depth(document: Any) -> None:
    """Raise `ValueError` for a document deeper than `MAX_DEPTH`."""
    parts = [document]
    for _ in range(MAX_DEPTH):
        tables = [part.values() if isinstance(part, dict) else part for part in parts if isinstance(part, dict | list)]
        parts = [item for table in tables for item in table]
    if parts:
        raise ValueError(TOO_DEEP)


def read_json(path: Path, form: Any = dict[str, Any]) -> dict[str, Any]:
    """Read a JSON document whose root is a table; `form` is the type of the keys that are read (`base.documents`).

    Raises
    ------
    Refused
        If the file cannot be read or is invalid; the message names it.
    """
    try:
        document: dict[str, Any] = parse_json(read_bytes(path))
        msgspec.convert(document, form)
    except OSError as reason:
        raise Refused(f"{path} cannot be read: {reason.strerror}") from None
    except (ValueError, msgspec.MsgspecError) as reason:
        raise Refused(f"{path} is damaged: {reason}") from None
    return document


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file atomically; a full disk raises `OSError` and leaves the old file."""
    with complete_file(path) as draft:
        draft.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8."""
    write_bytes(path, text.encode())


def write_json(path: Path, document: Any) -> None:
    """Write a JSON document; raise `ValueError` for NaN and infinity, which JSON lacks."""
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def replace_infinite(value: Any) -> Any:
    """Return a value, or nested values, for JSON, with infinity (possible for errors of a fall) and NaN as null."""
    if isinstance(value, Mapping):
        return {key: replace_infinite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_netcdf(path: Path, dataset: Any) -> None:
    """Write an xarray dataset as NetCDF-4, compressed losslessly.

    HDF5 works in memory, since it aborts the process if a disk is full. By CF no coordinate has a fill value.
    """
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {name: packed for name, variable in dataset.data_vars.items() if variable.dims}
    encoding |= {name: {"_FillValue": None} for name, variable in dataset.coords.items() if variable.dtype.kind == "f"}
    write_bytes(path, dataset.to_netcdf(engine="h5netcdf", encoding=encoding))


class Variables(NamedTuple):
    """What a dataset holds: dimensions, values and attributes of each variable and coordinate, and its attributes."""

    variables: Mapping[str, tuple[Any, Any, Mapping[str, Any]]]
    coords: Mapping[str, tuple[Any, Any, Mapping[str, Any]]]
    facts: Mapping[str, Any]


def write_variables(path: Path, dataset: Variables) -> None:
    """Write what `write_netcdf` writes, without xarray, whose import takes longer than most flights."""
    import h5netcdf
    import h5py

    stream = io.BytesIO()
    with h5netcdf.File(stream, "w") as file:
        file.attrs.update(dataset.facts)
        for name, (along, values, attributes) in {**dataset.coords, **dataset.variables}.items():
            dims = (along,) if isinstance(along, str) else along
            for dim, size in zip(dims, values.shape, strict=True):
                if dim not in file.dimensions:
                    file.dimensions[dim] = size
            more: dict[str, Any] = {}
            labels: list[str] = []
            if name in dataset.variables:
                more |= {"compression": "gzip", "compression_opts": 1, "shuffle": True} if dims else {}
                more |= {"fillvalue": float("nan")} if values.dtype.kind == "f" else {}
                labels = [label for label, (dim, _, _) in dataset.coords.items() if label != dim and dim in dims]
            is_text = values.dtype.kind == "U"
            written = file.create_variable(name, dims, h5py.string_dtype() if is_text else values.dtype, **more)
            written[...] = values.astype(object) if is_text else values
            written.attrs.update(attributes)
            if labels:
                written.attrs["coordinates"] = " ".join(labels)
    write_bytes(path, stream.getvalue())
