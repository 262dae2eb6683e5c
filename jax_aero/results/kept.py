"""Kept results: `docs/results/NAME.json`, the figures of a finished result.

A kept result has what its pages say: how it was made, and its figures. Those of a sweep are rows of flights, which are
pooled when they are read; those of a study or a benchmark are its summary.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Set
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from jax_aero.base import places
from jax_aero.base.files import read_json
from jax_aero.base.terminal import Refused
from jax_aero.results.sweep import SweepResult
from jax_aero.sweep import aggregate, populations

AGAIN = "keep the result again (jax-aero report keep)"
FOLDER = places.HOME / "docs" / "results"
MOST_LEVELS = 16
"""Greatest number of levels that are drawn in rows: the picture of more repeats the table."""

ALL = "all"
"""Level of an axis over which the flights of a row are pooled."""

LOST = "lost"
"""An infinite error, that of a lost flight, in a file."""


class Axis(msgspec.Struct):
    """An axis of a sweep, with the levels of its table in order."""

    name: str
    label: str
    unit: str
    levels: list[str | float]

    def show(self, level: str | float) -> str:
        """Return a level with its unit."""
        return f"{level:g} {self.unit}".rstrip() if isinstance(level, int | float) else level


class Kept(msgspec.Struct, kw_only=True, omit_defaults=True):
    """One kept result."""

    name: str
    result: str
    """Folder of the result, below `results/`."""
    title: str
    about: str = ""
    command: str
    created: str
    commit: str | None
    digest: str
    """Digest of the configuration and of the files that it names."""
    numerics: dict[str, int] = {}
    """Versions of the numbers of what computed it (`jax_aero.results.identity`); the first ones if none is named."""
    config: dict[str, Any] = {}
    """Configuration of a study; that of a sweep is its file."""
    seed: int | None = None
    each: str = ""
    """Number of flights of a cell, and how they differ."""
    axes: list[Axis] = []
    drawing: str = ""
    panels: str = ""
    paired: str = ""
    """Axis of pairs, two of whose levels each flight has."""
    pooled: list[str] = []
    """Labels of the axes that no row distinguishes."""
    shows: list[str] = []
    outcomes: dict[str, int] = {}
    """Number of flights by outcome."""
    columns: list[str] = []
    rows: list[list[Any]] = []
    """Figures of flights, by combination of levels; `None` is unknown."""
    firsts: list[list[Any]] = []
    """Outcome and figures (`keep.FIRST`) of the first flight of each cell, in the order of the sweep's cells.

    Empty where MuJoCo simulates or the controller is in Python.
    """
    firsts_flown: str = ""
    """When and with which commit these were flown, if not with the other flights."""
    summary: Any = None
    """Figures of a study or a benchmark."""
    seal: str = ""
    """Digest of all this, by which an edited number is recognised."""

    def table(self, pooled: Set[str] = frozenset()) -> list[dict[str, Any]]:
        """Return the rows as tables, or those of the flights pooled over some axes, whose level is then `ALL`."""
        axes = {axis.name for axis in self.axes}
        rows = [
            {
                name: math.inf if value == LOST and name not in axes else value
                for name, value in zip(self.columns, row, strict=True)
            }
            for row in self.rows
        ]
        if not pooled:
            return rows
        groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
        for row in rows:
            levels = tuple(ALL if axis.name in pooled else row[axis.name] for axis in self.axes)
            groups.setdefault(levels, []).append(row)
        names, times = [axis.name for axis in self.axes], 2 if self.paired in pooled else 1
        return [dict(zip(names, at, strict=True)) | aggregate.pool(mine, times) for at, mine in groups.items()]

    def cells(self, pooled: Set[str] = frozenset()) -> list[dict[str, Any]]:
        """Return the rows, pooled or not, with the columns of a sweep's table of cells."""
        return [row | aggregate.with_intervals(row) for row in self.table(pooled)]

    @property
    def sweep(self) -> SweepResult:
        """Return a kept sweep as figures and report read one."""
        axes = [msgspec.to_builtins(axis) for axis in self.axes]
        document = {"title": self.title, "drawing": self.drawing, "panels": self.panels, "axes": axes}
        cells = pd.DataFrame(self.cells()).fillna(np.nan)
        return SweepResult(
            self.name,
            document | {"config_digest": self.digest},
            cells,
            each=f"flights: {self.each}",
        )

    @property
    def is_drawn(self) -> bool:
        """Whether a picture adds to the table, and needs no more than its rows."""
        if self.drawing in ("levels", "front"):
            return all(len(axis.levels) <= MOST_LEVELS for axis in self.axes)
        return self.drawing in ("curve", "map") and not self.pooled


def names() -> list[str]:
    """Return the names of all kept results."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


@cache
def read(name: str) -> Kept:
    """Return a kept result."""
    path = FOLDER / f"{name}.json"
    if not path.is_file():
        raise Refused(f"there is no kept result `{name}`{places.did_you_mean(name, names())}")
    found = msgspec.convert(read_json(path, Kept), Kept)
    if found.seal != seal_of(found):
        raise Refused(f"{path} is not what was written there: {AGAIN}")
    if found.rows and (missing := {*aggregate.KEPT} - {*found.columns}):
        raise Refused(f"{path} has no column `{min(missing)}`: {AGAIN}")
    if wrong := contradiction(found):
        raise Refused(f"{path} contradicts itself, {wrong}: {AGAIN}")
    return found


def contradiction(kept: Kept) -> str:
    """Return where rows contradict themselves or the outcomes of all flights; empty if nowhere.

    A seal says that a file was written as it is, not that its numbers belong together.
    """
    rows = kept.table()
    for number, row in enumerate(rows):
        lost, lasting = row["flights"] - row["completed"] - row["landed"], ("landing", "off_course", "crashed")
        if row["lost"] != lost or lost < sum(row[end] for end in lasting) or row["on_course"] > row["completed"]:
            return f"in the counts of row {number}"
        for error in aggregate.KEPT_ERRORS:
            of_all, of_upright = (
                [row[populations.quantile(error, end, population)] for end in populations.QUANTILES]
                for population in populations.populations(error)
            )
            known = [[value for value in ends if value is not None] for ends in (of_all, of_upright)]
            pairs = [(a, b) for a, b in zip(of_all, of_upright, strict=True) if a is not None and b is not None]
            is_alike = all(a >= b for a, b in pairs) if lost else of_all == of_upright  # a loss lowers no quantile
            if known != [sorted(ends) for ends in known] or not is_alike or (lost > 0) != (math.inf in of_all):
                return f"in the errors of row {number}"
    times = 2 if kept.paired else 1
    for end in ("completed", "landed", "landing", "off_course", "crashed"):
        if rows and sum(row[end] for row in rows) != times * kept.outcomes.get(end, 0):
            return f"in the flights that end as {end}"
    return ""


def seal_of(kept: Kept) -> str:
    """Return the digest of what is kept."""
    text = json.dumps(msgspec.to_builtins(msgspec.structs.replace(kept, seal="")))
    document = msgspec.to_builtins(msgspec.convert(json.loads(text), Kept))  # with the types that a file gives
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def to_json(kept: Kept) -> str:
    """Return a kept result as JSON, sealed, with a line for each row."""
    document = msgspec.to_builtins(msgspec.structs.replace(kept, seal=seal_of(kept)))
    tables = {name: document.pop(name) for name in ("rows", "firsts") if name in document}
    text = json.dumps(document, indent=1, ensure_ascii=False)
    for name, rows in tables.items():
        lines = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in rows)
        text = f'{text[:-2]},\n "{name}": [\n{lines}\n ]\n}}'
    return f"{text}\n"


def cases_of(summary: Mapping[str, Any] | None) -> dict[str, dict[str, Any]]:
    """Return the figures of a study by case, those without case under "".

    The cases are nested tables, or the first part of the names: `fine mesh: drag [m2]`.
    """
    cases: dict[str, dict[str, Any]] = {"": {}}
    for key, value in (summary or {}).items():
        if isinstance(value, Mapping):
            cases.setdefault(str(key), {}).update(value)
        else:
            case, _, figure = str(key).rpartition(": ")
            cases.setdefault(case, {})[figure] = value
    return cases
