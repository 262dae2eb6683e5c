"""Fly a sweep: chunk by chunk, from where it was left, into `results/sweeps/NAME/`.

```text
sweep.json       what is flown, and by what; at the end also how long it took
chunks/          finished chunks of a sweep under way; a file is there completely or not at all
table.parquet    every flight       cells.parquet    every cell
```
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import time
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import pyarrow.parquet as pq

from experiments import Refused, engines, manifest
from experiments.sweep import table
from experiments.sweep.design import Design
from experiments.sweep.progress import Progress
from jax_aero import rust, tables
from jax_aero.files import write_json
from jax_aero.result import Outcome

RESULTS = manifest.RESULTS / "sweeps"


class Workers(Protocol):
    """Processes that fly chunks: local ones, or a cluster's."""

    def fly(self, design: Design, chunks: list[int], progress: Progress) -> Iterator[tuple[int, Any]]:
        """Yield the number and the table of every chunk, as they end."""
        ...


@dataclass(frozen=True)
class Local:
    """Here, with one flight per thread."""

    threads: int | None = None

    def fly(self, design: Design, chunks: list[int], progress: Progress) -> Iterator[tuple[int, Any]]:
        """Fly chunks one after the other."""
        engine = engines.engine(design.spec.engine)
        for chunk in chunks:
            yield chunk, fly_chunk(design, chunk, engine, self.threads, progress.within_chunk)


def fly_chunk(
    design: Design,
    chunk: int,
    engine: engines.Engine,
    threads: int | None = None,
    progress: rust.Progress | None = None,
) -> Any:
    """Return the table of one chunk."""
    indices = design.chunk(chunk)
    configs = [design.row_config(row) for row in indices]
    return table.rows(design, indices, configs, engine.fly_batch(configs, threads, progress))


def run(design: Design, workers: Workers, *, out: Path | None = None, overwrite: bool = False) -> Path:
    """Fly what is missing of a sweep; return its folder."""
    folder = (out or RESULTS) / design.spec.name
    if overwrite:
        _clear(folder)
    if (folder / "cells.parquet").is_file():
        _same(folder, design, running=False)
        print(f"{os.path.relpath(folder)} is finished already; --overwrite flies it again")
        return folder
    design.check()
    chunks = folder / "chunks"
    if (folder / "sweep.json").is_file():
        _same(folder, design, running=True)
    chunks.mkdir(parents=True, exist_ok=True)
    for draft in chunks.glob(".*.draft.parquet"):
        draft.unlink()
    document = _document(design)
    write_json(folder / "sweep.json", document)

    missing = [chunk for chunk in range(design.n_chunks) if not _path(chunks, chunk).is_file()]
    flown = sum(len(design.chunk(chunk)) for chunk in missing)
    started = time.perf_counter()
    with Progress(design.spec.name, design.n_rows, design.n_rows - flown) as progress:
        for chunk, part in workers.fly(design, missing, progress):
            table.write(part, _path(chunks, chunk))
            progress.chunk_done(len(design.chunk(chunk)))
    seconds = time.perf_counter() - started
    _finish(folder, design, document, flown, seconds)
    return folder


def _finish(folder: Path, design: Design, document: dict[str, Any], flown: int, seconds: float) -> None:
    """Join the chunks; the table of cells is written last and says that all is there."""
    chunks = folder / "chunks"
    parts = (pq.read_table(_path(chunks, chunk)) for chunk in range(design.n_chunks))
    table.write_parts(parts, table.schema(design), folder / "table.parquet")
    whole = pq.read_table(folder / "table.parquet")
    outcomes = whole["outcome"].to_pylist()
    document["finished"] = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "flights": flown,
        "seconds": round(seconds, 3),
        "flights_per_minute": round(60.0 * flown / seconds, 1) if flown else None,
        "outcomes": {outcome: outcomes.count(outcome) for outcome in (*typing.get_args(Outcome), "error")},
    }
    write_json(folder / "sweep.json", document)
    table.write(table.cells(design, whole), folder / "cells.parquet")
    shutil.rmtree(chunks)


def _path(chunks: Path, chunk: int) -> Path:
    return chunks / f"{chunk:06}.parquet"


def _document(design: Design) -> dict[str, Any]:
    spec = design.spec
    return {
        "name": spec.name,
        "title": spec.title,
        "description": spec.description,
        "drawing": spec.drawing,
        "panels": spec.panels,
        "design": spec.design,
        "axes": [
            {
                "name": axis.name,
                "label": axis.label or axis.name,
                "unit": axis.unit,
                "levels": [level.label for level in axis.levels],
            }
            for axis in spec.axis
        ],
        "base": spec.base,
        "set": manifest.portable(dict(spec.set)),
        "perturbation": tables.plain(spec.perturbation),
        "seed": spec.seed,
        "repeats": spec.repeats,
        "rows": design.n_rows,
        "engine": spec.engine,
        "config_hash": design.digest,
        "code_hash": code_hash(),
        "git": manifest.git_state(),
        "versions": manifest.versions(),
        "device": manifest.device(),
    }


def code_hash() -> str:
    """Return a hash of the compiled crate: rows flown by two builds do not belong into one table."""
    module = importlib.util.find_spec("jax_aero._core")
    if module is None or module.origin is None:
        raise Refused("the compiled module jax_aero._core is not here; `make setup` builds it")
    return hashlib.sha256(Path(module.origin).read_bytes()).hexdigest()[:16]


def _same(folder: Path, design: Design, *, running: bool) -> None:
    """Refuse a folder that holds another sweep, or chunks of another build."""
    try:
        found = json.loads((folder / "sweep.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = {}
    shown = os.path.relpath(folder)
    if found.get("config_hash") != design.digest:
        raise Refused(f"{shown} holds another sweep of this name; choose another --out, or --overwrite it")
    if running and found.get("code_hash") != code_hash():
        raise Refused(f"{shown} was begun by another build of the crate; --overwrite starts from the beginning")


def _clear(folder: Path) -> None:
    if not folder.exists():
        return
    known = {"sweep.json", "chunks", "table.parquet", "cells.parquet"}
    unrelated = {entry.name for entry in folder.iterdir() if not entry.name.startswith(".")} - known
    if unrelated:
        raise Refused(f"{os.path.relpath(folder)} also holds {', '.join(sorted(unrelated))}, so it is not overwritten")
    shutil.rmtree(folder)
