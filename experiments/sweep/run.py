"""Fly a sweep chunk by chunk, resume it, or continue it with more repeats, into `results/sweeps/NAME/`.

```text
sweep.json       sweep and code; at the end also duration and checksums
chunks/          finished chunks of an incomplete sweep, with checksums
table.parquet    every flight       cells.parquet    every cell
```
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from experiments import Refused, backends, manifest
from experiments.cluster import Ray
from experiments.identity import ANOTHER, Identity
from experiments.sweep import columns, table
from experiments.sweep.chunks import Chunks, parquet
from experiments.sweep.design import Design
from experiments.sweep.spec import Spec
from jax_aero import rust
from jax_aero.base import documents, places, plain
from jax_aero.base.files import checksums, find_damaged, lock, read_json, resolve, write_bytes, write_json
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import progress_bar

RESULTS = places.RESULTS / "sweeps"

PRESENTATION = ("title", "description", "drawing", "panels", "axes")
"""Keys of `SWEEP_FILE` that only affect the figure; a finished sweep takes them from its present file."""

LINE_INTERVAL = 15.0
"""Time between two reports of the progress if the output is not a terminal [s]."""

SWEEP_FILE, TABLES = "sweep.json", ("table.parquet", "cells.parquet")


def _fly_chunks(
    design: Design, chunks: list[range], workers: int | None, cluster: Ray | None, progress: rust.Progress
) -> Iterator[tuple[range, Any]]:
    """Yield rows and table of every chunk: here, one flight per thread, or on a cluster, one chunk per processor."""
    if cluster:
        # The sweep is read and resolved here; nodes only read the robot's files.
        shared = (design.spec, design.bases)
        yield from cluster.spread(_fly_remotely, shared, dict(zip(chunks, chunks, strict=True)), modules_of(design))
        return
    engine = backends.backend(design.spec.engine)
    for chunk in chunks:
        yield chunk, fly_chunk(design, chunk, engine, workers, progress)


def _fly_remotely(shared: tuple[Spec, Any], chunk: range) -> Any:
    spec, bases = shared
    design = Design(spec)
    vars(design)["bases"] = bases
    return fly_chunk(design, chunk, backends.backend(spec.engine), threads=1)


def fly_chunk(
    design: Design,
    chunk: range,
    engine: backends.Backend,
    threads: int | None = None,
    progress: rust.Progress | None = None,
) -> Any:
    """Return the table of one chunk."""
    configs = [design.row_config(row) for row in chunk]
    flown = engine.fly_batch(configs, threads, progress)
    return table.rows(design.spec, design.cells, chunk, configs, flown)


def run(
    design: Design,
    *,
    workers: int | None = None,
    cluster: Ray | None = None,
    out: Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Fly the missing chunks of a sweep, here or on a cluster; return its folder."""
    folder = (out or RESULTS) / design.spec.name
    with lock(folder):
        _run(design, workers, cluster, resolve(folder), overwrite=overwrite)
    return folder


def _run(design: Design, workers: int | None, cluster: Ray | None, folder: Path, *, overwrite: bool) -> None:
    document = _document(design, folder)
    found, shown = {} if overwrite else _read_document(folder, design), os.path.relpath(folder)
    # Chunks are also those of more repeats, which continue a sweep.
    chunks = Chunks(folder / "chunks", str(identity_of(design, repeats=1)))
    for draft in folder.rglob(".*.draft.*"):  # left by a process that was killed
        draft.unlink()
    if "finished" in found and found["repeats"] == design.spec.repeats:
        chunks.clear()  # in case a process was killed before this
        if found != (shown_anew := found | {key: document[key] for key in PRESENTATION}):
            write_json(folder / SWEEP_FILE, shown_anew)
        print(f"{shown} is finished already; --overwrite flies it again")
        return
    design.check()
    backends.backend(design.spec.engine)
    if overwrite and folder.exists():  # only after all checks of the new one
        _clear(folder)
    chunks.folder.mkdir(parents=True, exist_ok=True)
    if "finished" in found:  # with fewer repeats
        before = read_table(folder / TABLES[0])
        chunks.write(range(before.num_rows), before)
    whole = chunks.find_whole(design.n_rows)
    if damaged := chunks.remove(but=whole):
        print(f"{shown}: {', '.join(damaged)}: damaged, or no chunk of this sweep; flown again", file=sys.stderr)
    write_json(folder / SWEEP_FILE, document)
    for name in TABLES:  # of fewer repeats
        (folder / name).unlink(missing_ok=True)

    missing = design.missing(whole)
    flown = sum(map(len, missing))
    done = design.n_rows - flown
    if done:
        print(f"{design.spec.name}: {done} of {design.n_rows} flights are there already", file=sys.stderr)
    started = time.perf_counter()
    interval = 0.1 if sys.stderr.isatty() else LINE_INTERVAL
    with progress_bar("flight", design.spec.name, initial=done, disable=False, mininterval=interval) as show:

        def show_within(flights: int, _: int) -> None:
            show(done + flights, design.n_rows)

        for chunk, part in _fly_chunks(design, missing, workers, cluster, show_within):
            chunks.write(chunk, part)
            done += len(chunk)
            show(done, design.n_rows)
    _finish(folder, design, document, chunks, flown, time.perf_counter() - started)


def _finish(folder: Path, design: Design, document: dict[str, Any], chunks: Chunks, flown: int, seconds: float) -> None:
    """Join the chunks; the description is written last and marks the sweep as complete."""
    whole = pa.concat_tables(map(chunks.read, chunks.find_whole(design.n_rows)))
    of_cells = table.cells(design.spec, design.cells, whole)
    for name, content in zip(TABLES, (whole, of_cells), strict=True):
        write_bytes(folder / name, parquet(content))
    outcomes = whole["outcome"].to_pylist()
    if errors := whole["error"].drop_null().to_pylist():
        print(f"{design.spec.name}: {len(errors)} flights could not be flown, first: {errors[0]}", file=sys.stderr)
    document["finished"] = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "flights": flown,
        "seconds": round(seconds, 3),
        "flights_per_minute": round(60.0 * flown / seconds, 1) if flown else None,
        "outcomes": {outcome: outcomes.count(outcome) for outcome in (*columns.OUTCOMES, "error")},
        "files": {name: checksum for name, checksum in checksums(folder).items() if name in TABLES},
    }
    write_json(folder / SWEEP_FILE, document)
    chunks.clear()


def _document(design: Design, folder: Path) -> dict[str, Any]:
    return {
        **describe(design.spec),
        "file": os.path.relpath(design.file, folder) if design.file else None,
        "rows": design.n_rows,
        **identity_of(design).facts,
        "git": manifest.git_state(),
        "versions": manifest.versions(design.spec.engine),
        "device": manifest.device(),
    }


def describe(spec: Spec) -> dict[str, Any]:
    """Return the part of `SWEEP_FILE` that comes from the file of a sweep."""
    keys = ("name", "title", "description", "drawing", "panels", "design", "seed", "repeats", "chunk", "engine")
    perturbation = plain.to_builtins(spec.perturbation)
    flown: dict[str, Any] = manifest.make_portable(
        {"base": spec.base, "set": dict(spec.set), "perturbation": perturbation}
    )
    axes = [
        {
            "name": axis.name,
            "label": axis.label or axis.name,
            "unit": axis.unit,
            "levels": [level.label for level in axis.levels],
        }
        for axis in spec.axes
    ]
    return {key: getattr(spec, key) for key in keys} | {"axes": axes} | flown


def identity_of(design: Design, repeats: int | None = None) -> Identity:
    """Return the identity of a sweep, also with other repeats; rows of different ones must not be in one table."""
    return Identity(design.digest_of(repeats or design.spec.repeats), modules_of(design))


def modules_of(design: Design) -> tuple[str, ...]:
    """Return the modules that determine the rows of a sweep."""
    return __name__, backends.MODULES[design.spec.engine]


def _read_document(folder: Path, design: Design) -> dict[str, Any]:
    """Return the description in a folder, also of fewer repeats; refuse that of another sweep, and damaged tables."""
    path, shown = folder / SWEEP_FILE, os.path.relpath(folder)
    if not os.path.lexists(path):
        return {}
    try:
        found = read_json(path, documents.SweepUnderWay)
    except Refused as reason:
        raise Refused(f"{reason}; choose another --out, or --overwrite it") from None
    identity = identity_of(design, min(found["repeats"], design.spec.repeats))
    if (difference := identity.difference(found)) == ANOTHER:
        raise Refused(f"{shown} holds another sweep of this name; choose another --out, or --overwrite it")
    if difference:
        what = "flown" if "finished" in found else "begun"
        raise Refused(f"{shown} was {what} by {difference}; --overwrite starts from the beginning")
    if "finished" in found and (name := find_damaged(folder, found["finished"].get("files", {}))):
        raise Refused(f"{shown}/{name} is not what was written there; --overwrite flies it again")
    return found


def _clear(folder: Path) -> None:
    """Remove a sweep's folder; do nothing if it is something else."""
    own = re.compile(rf"{SWEEP_FILE}|{'|'.join(TABLES)}|chunks/[\d-]+\.chunk|(chunks/)?\.[\w-]+\.\d+\.draft\.\w+")
    files = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()]
    if others := sorted(name for name in files if not own.fullmatch(name)):
        raise Refused(f"{os.path.relpath(folder)} also holds {', '.join(others)}, so it is not overwritten")
    shutil.rmtree(folder)
