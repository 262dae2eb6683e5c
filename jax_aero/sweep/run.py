"""Fly a sweep chunk by chunk, go on with it (`jax_aero.results.work`), or continue it with more repeats.

```text
sweep.json       sweep, identity, duration and checksums, in `results/sweeps/NAME/`
table.parquet    every flight; above 10,000 a folder of parts
cells.parquet    every cell
```
"""

from __future__ import annotations

import io
import os
import re
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from jax_aero import backends, rust
from jax_aero.base import documents, places, plain_values
from jax_aero.base.files import lock_work, resolve, write_bytes, write_json
from jax_aero.base.kinds import KINDS
from jax_aero.base.parquet import read_parquet, read_table
from jax_aero.base.terminal import progress_bar
from jax_aero.results import manifest, record
from jax_aero.results.identity import Identity, computed_by
from jax_aero.results.work import Work
from jax_aero.sweep import columns, table
from jax_aero.sweep.cluster import Ray
from jax_aero.sweep.design import Design
from jax_aero.sweep.spec import Spec

RESULTS = places.RESULTS / "sweeps"

PRESENTATION = ("title", "description", "drawing", "panels", "axes")
"""Keys of `SWEEP_FILE` that only affect the figure; a finished sweep takes them from its present file."""

LINE_INTERVAL = 15.0
"""Time between two reports of the progress if the output is not a terminal [s]."""

COUNT_INTERVAL = 0.15
"""Time between two looks at how many flights have ended [s]."""

PART_ROWS = 10_000
"""Greatest number of flights in a file."""

SWEEP_FILE, TABLES = places.SWEEP_FILE, KINDS["sweeps"].files


def _fly_chunks(
    design: Design, chunks: list[range], workers: int | None, cluster: Ray | None, progress: rust.Progress
) -> Iterator[tuple[range, Any]]:
    """Yield rows and table of every chunk: here, or on a cluster, one chunk per processor."""
    if cluster:
        yield from cluster.spread(_fly_remotely, design, dict(zip(chunks, chunks, strict=True)))
    else:
        yield from _fly_here(design, chunks, workers, progress)


def _fly_here(
    design: Design, chunks: list[range], workers: int | None, progress: rust.Progress
) -> Iterator[tuple[range, Any]]:
    """Yield the chunks in order; the next flies while the last flights of one end and its rows are made."""
    backend = backends.backend(design.spec.backend)
    flown: dict[range, int] = {}
    is_over = threading.Event()

    def fly(chunk: range) -> Any:
        def count(done: int, _: int) -> None:
            if is_over.is_set():
                raise KeyboardInterrupt
            flown[chunk] = done

        return fly_chunk(design, chunk, backend, workers, count)

    waiting = iter(chunks)
    with ThreadPoolExecutor(backend.together) as pool:
        try:
            running = deque((chunk, pool.submit(fly, chunk)) for chunk in islice(waiting, backend.together))
            while running:
                chunk, answer = running.popleft()
                while not wait([answer], timeout=COUNT_INTERVAL).done:
                    progress(sum(flown.values()), design.n_rows)
                flown.pop(chunk, None)
                running.extend((after, pool.submit(fly, after)) for after in islice(waiting, 1))
                yield chunk, answer.result()
        finally:
            is_over.set()


def _fly_remotely(design: Design, chunk: range) -> Any:
    return fly_chunk(design, chunk, backends.backend(design.spec.backend), threads=1)


def fly_chunk(
    design: Design,
    chunk: range,
    backend: backends.Backend,
    threads: int | None = None,
    progress: rust.Progress | None = None,
) -> Any:
    """Return the table of one chunk."""
    configs = [design.row_config(row) for row in chunk]
    hashes = [design.config_hash(design.place(row)[0], config) for row, config in zip(chunk, configs, strict=True)]
    flown = backend.fly_batch(configs, threads, progress)
    design.refuse_samples(chunk, [one.reason if isinstance(one, backends.Failure) else None for one in flown])
    return table.rows(design.spec, design.cells, chunk, configs, hashes, flown)


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
    with lock_work(folder):
        _run(design, workers, cluster, resolve(folder), overwrite=overwrite)
    return folder


def _run(design: Design, workers: int | None, cluster: Ray | None, folder: Path, *, overwrite: bool) -> None:
    document = _document(design, folder)
    # Finished chunks are also those of more repeats, which continue a sweep.
    work = Work.on(folder, identity_of(design, repeats=1))
    before = None if overwrite else record.read_manifest(folder, documents.FinishedSweep)
    repeats = min(before["repeats"], design.spec.repeats) if before else design.spec.repeats
    is_continued, form = repeats < design.spec.repeats, documents.FinishedSweep
    identity = identity_of(design, repeats)
    existing = record.find_existing(folder, identity, form, overwrite=overwrite, quiet=is_continued)
    if existing is not None and not is_continued:
        work.clear()  # in case a process was killed before this
        if existing != (shown_anew := existing | {key: document[key] for key in PRESENTATION}):
            write_json(folder / SWEEP_FILE, shown_anew)
        return
    design.check()
    backends.backend(design.spec.backend)
    parts = dict(_read_parts(work, design.n_rows))
    if existing is not None:
        whole = read_table(folder / TABLES[0])
        parts[range(whole.num_rows)] = whole
    missing = design.missing(sorted(parts, key=lambda rows: rows.start))
    flown = sum(map(len, missing))
    done = design.n_rows - flown
    if done:
        print(f"{design.spec.name}: {done} of {design.n_rows} flights are there already", file=sys.stderr)
    started = time.perf_counter()
    interval = 0.1 if sys.stderr.isatty() else LINE_INTERVAL
    with progress_bar("flight", design.spec.name, initial=done, disable=False, mininterval=interval) as show:

        def show_within(flights: int, total: int) -> None:
            show(done + flights, total)

        for chunk, part in _fly_chunks(design, missing, workers, cluster, show_within):
            content = parquet(part)
            work.write(f"{chunk.start:07}-{chunk.stop:07}", content)
            parts[chunk] = read_parquet(content)
            done += len(chunk)
            show(done, design.n_rows)
    in_order = sorted(parts, key=lambda rows: rows.start)
    whole = pa.concat_tables(parts[rows] for rows in in_order)
    _write(folder, design, document, whole, flown, time.perf_counter() - started)
    work.clear()


def _read_parts(work: Work, count: int) -> Iterator[tuple[range, Any]]:
    """Yield the finished chunks of the first `count` rows."""
    for job in work.jobs():
        if name := re.fullmatch(r"(\d+)-(\d+)", job):
            rows = range(int(name[1]), int(name[2]))
            if rows.stop <= count and (content := work.read(job)) is not None:
                yield rows, read_parquet(content)


def _write(folder: Path, design: Design, document: dict[str, Any], whole: Any, flown: int, seconds: float) -> None:
    """Write the result from the table of all flights."""
    of_cells = table.cells(design.spec, design.cells, whole)
    outcomes = whole["outcome"].to_pylist()
    if errors := whole["error"].drop_null().to_pylist():
        print(f"{design.spec.name}: {len(errors)} flights could not be flown, first: {errors[0]}", file=sys.stderr)
    finished = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "flights": flown,
        "seconds": round(seconds, 3),
        "flights_per_minute": round(60.0 * flown / seconds, 1) if flown else None,
        "outcomes": {outcome: outcomes.count(outcome) for outcome in (*columns.OUTCOMES, "error")},
    }

    def write(draft: Path) -> None:
        flights, cells = TABLES
        write_bytes(draft / cells, parquet(of_cells))
        for name, part in _parts(flights, whole).items():
            (draft / name).parent.mkdir(exist_ok=True)
            write_bytes(draft / name, parquet(part))

    record.write_result(folder, document | {"finished": finished}, write, replace=True, named=SWEEP_FILE)


def _parts(name: str, whole: pa.Table) -> dict[str, pa.Table]:
    """Return the files of a table: one, or of a longer one a folder of parts, which every reader of Parquet takes."""
    if whole.num_rows <= PART_ROWS:
        return {name: whole}
    firsts = range(0, whole.num_rows, PART_ROWS)
    return {f"{name}/{first:08}.parquet": whole.slice(first, PART_ROWS) for first in firsts}


def parquet(content: pa.Table) -> bytes:
    """Return a table as a Parquet file."""
    stream = io.BytesIO()
    pq.write_table(content, stream, compression="zstd")
    return stream.getvalue()


def _document(design: Design, folder: Path) -> dict[str, Any]:
    return {
        **describe(design.spec),
        "file": os.path.relpath(design.file, folder) if design.file else None,
        "rows": design.n_rows,
        **identity_of(design).facts,
        "git": manifest.git_state(),
        "versions": manifest.versions(design.spec.backend),
        "device": manifest.device(),
    }


def describe(spec: Spec) -> dict[str, Any]:
    """Return the part of `SWEEP_FILE` that comes from the file of a sweep."""
    keys = ("name", "title", "description", "drawing", "panels", "design", "seed", "repeats", "chunk", "backend")
    perturbation = plain_values.to_builtins(spec.perturbation)
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
    return Identity(design.digest_of(repeats or design.spec.repeats), computed_by(design.spec.backend))
