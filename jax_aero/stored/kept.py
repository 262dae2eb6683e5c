"""Kept results: `docs/results/NAME.json`, the figures of a finished result, and their tables.

A kept result has what its pages say: how it was made, and its figures. Those of a sweep are rows of flights, which are
pooled when they are read; those of a study or a benchmark are its summary.

A column of a sweep's table is a figure (`aggregate.KEPT`), a count of several outcomes (`completed + landed`), or its
share of flights with its Wilson interval of 95 % (`share completed + landed`). A column of a study's is a figure of its
cases.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence, Set
from functools import cache
from itertools import combinations
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
import pandas as pd

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.files import read_json
from jax_aero.base.quantities import converted
from jax_aero.base.terminal import Refused
from jax_aero.sweep import aggregate
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.populations import OF_ALL, OF_UPRIGHT, QUANTILES, populations, quantile
from jax_aero.sweep.result import SweepResult

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
    kept = msgspec.convert(read_json(path, Kept), Kept)
    if kept.seal != seal_of(kept):
        raise Refused(f"{path} is not what was written there: {AGAIN}")
    if kept.rows and (missing := {*aggregate.KEPT} - {*kept.columns}):
        raise Refused(f"{path} has no column `{min(missing)}`: {AGAIN}")
    if wrong := contradiction(kept):
        raise Refused(f"{path} contradicts itself, {wrong}: {AGAIN}")
    return kept


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
                [row[quantile(error, end, population)] for end in QUANTILES] for population in populations(error)
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


# --- tables -----------------------------------------------------------------------------------------------------------

UNIT = re.compile(r"\s*\[(?P<unit>[^\]]+)\]$")
SIGNS = str.maketrans("234", "²³⁴")

Names = list[str] | dict[str, str]
"""Names, or names by what a table says in their place."""
Rows = tuple[list[str], list[list[str]]]
"""Headings and cells."""
T = TypeVar("T")


class Value(NamedTuple):
    """A number with its unit, or a text."""

    value: Any
    unit: str = ""

    def text(self, digits: int, unit: str | None = None) -> str:
        """Return it in a unit, a number with at least so many significant digits."""
        if self.value is None or self.value != self.value:
            return ""
        if self.value == math.inf:
            return LOST
        if isinstance(self.value, str):
            return self.value
        value = self.value if unit is None else converted(self.value, self.unit, unit)
        if isinstance(value, float):
            before = math.floor(math.log10(abs(value))) if value else 0
            return f"{value:.{max(0, digits - 1 - before)}f}".replace("-", "−")
        return str(value)


def by_heading(names: Names) -> dict[str, str]:
    """Return names by what is said in their place."""
    return names if isinstance(names, dict) else {name: name for name in names}


def one(known: Mapping[str, T], name: str, what: str) -> T:
    """Return what has this name; refuse another one."""
    if name not in known:
        raise Refused(f"there is no {what} `{name}`{places.did_you_mean(name, known)}")
    return known[name]


def table_of(names: Names, rows: Sequence[Mapping[str, Value]], labels: Mapping[str, str], digits: int = 2) -> Rows:
    """Return headings with units, and the cells below them; a column has one unit."""
    headings, columns = [], []
    for heading, name in by_heading(names).items():
        values = [one(row, name, "column") for row in rows]
        unit = next((value.unit for value in values if value.unit), "")
        if heading == name:
            heading = labels.get(name, name)
        if match := UNIT.search(heading):
            unit, heading = match["unit"], heading[: match.start()]
        headings.append(f"{heading} [{unit}]" if unit else heading)
        columns.append([value.text(digits, unit) for value in values])
    return headings, [list(cells) for cells in zip(*columns, strict=True)]


# --- sweeps -----------------------------------------------------------------------------------------------------------

STATISTICS = {"p10": "10 %", "median": "median", "p90": "90 %", "worst": "greatest"}
POPULATIONS = {OF_ALL: "of all", OF_UPRIGHT: "of upright"}
QUANTITIES = {
    "max_rotation_error_deg": ("rotation error", "°", 1.0),
    "max_com_error": ("position error", "cm", 100.0),
}
"""Errors as tables show them: words, unit and factor, by columns of the table of flights."""
ERRORS = {
    quantile(column, end, population): (f"{words}, {said} {of}", unit, factor)
    for column, (words, unit, factor) in QUANTITIES.items()
    for population, of in POPULATIONS.items()
    for end, said in STATISTICS.items()
}
"""Heading, unit and factor of each quantile."""
UNKNOWN = "?"
"""An error of all flights that is not kept: that of upright ones has no number where there are none."""
TIMES = {"found_s": "found after", "announced_s": "announced before", "lost_s": "lost at"}
ENDS = ("completed", "landed", "landing", "off_course", "crashed", "fell")
"""Counts that add up to all flights."""
SHOWN = {
    "share": (["share completed + landed"], "Share: with its Wilson interval of 95 %."),
    "errors": (
        [
            quantile(column, end, population)
            for column in QUANTITIES
            for end, population in (("median", OF_ALL), ("median", OF_UPRIGHT), ("worst", OF_UPRIGHT))
        ],
        (
            "Errors: the greatest of a flight. Of all: lost flights have the greatest, `lost`; `?` is not kept. "
            "Of upright: flights that completed or landed."
        ),
    ),
    "found": (["found_s"], "Found after: median time since the failure, where half of the flights find one."),
    "announced": (["announced_s"], "Announced before: median time from the first mode to the loss."),
    "modes": (["modes"], "Modes: those of at least half of the flights."),
}
"""Columns of a page beside the counts, and what it says of them."""


def _label(column: str) -> str:
    """Return the heading of a column: of `rotation_error_deg_p90_of_all` "rotation error, 90 % of all"."""
    if column in ERRORS:
        return ERRORS[column][0]
    return TIMES.get(column, column.replace("_", " "))


def rows_of(document: Kept, pooled: Set[str] = frozenset()) -> list[dict[str, Any]]:
    """Return the rows of a sweep with the flights that fell, and without a time of finding that few flights have."""
    rows = document.table(pooled)
    for row in rows:
        row["fell"] = row["lost"] - row["landing"] - row["off_course"] - row["crashed"]
        row["found_s"] = row["found_s"] if 2 * row["degraded"] >= row["flights"] else None
    return rows


def _figures(row: Mapping[str, Any], names: Iterable[str], axes: Iterable[str]) -> dict[str, Value]:
    """Return the figures of a row, and these combinations of counts, each with its flights."""
    cells = {"flights": Value(row["flights"])}
    for column in row.keys() - {*axes, "flights"}:
        if column == "modes":
            cells[column] = Value(" ".join(f"`{name}`" for name, bit in rust.MODES.items() if (row[column] or 0) & bit))
        elif column in ERRORS:
            _, unit, factor = ERRORS[column]
            unknown = UNKNOWN if column.endswith(OF_ALL) else None
            cells[column] = Value(unknown if row[column] is None else factor * row[column], unit)
        elif column in TIMES:
            cells[column] = Value(row[column], "s")
        else:
            cells[column] = Value(f"{row[column]} of {row['flights']}")
    for name in names:
        counts = name.removeprefix("share ").split(" + ")
        if name not in cells and all(isinstance(row.get(count), int) for count in counts):
            count, flights = sum(row[count] for count in counts), row["flights"]
            share, low, high = (f"{100.0 * x:.0f}" for x in (count / flights, *wilson(count, flights)))
            is_share = name.startswith("share ")
            cells[name] = Value(f"{share} % ({low} to {high})" if is_share else f"{count} of {flights}")
    return cells


def sweep_table(
    document: Kept, columns: Names, asked: Mapping[str, Names | str], across: str = "", digits: int = 2
) -> Rows:
    """Return a row for each combination of levels, that of panels last; an axis of one level has no column.

    `asked` are levels of some axes. The columns are those of the axis `across`, of one quantity, if there is one.
    """
    axes = {axis.name: axis for axis in sorted(document.axes, key=lambda axis: axis.name == document.panels)}
    for name in (*asked, *([across] if across else [])):
        one(axes, name, "axis")
    chosen: dict[str, dict[Any, str]] = {}
    for name, axis in axes.items():
        level_of = {axis.show(level): level for level in axis.levels} | {ALL: ALL}
        said = asked.get(name, list(map(axis.show, axis.levels)))
        texts = by_heading([said] if isinstance(said, str) else said)
        chosen[name] = {one(level_of, level, f"level of {name}"): text for text, level in texts.items()}
    names = [name for name in axes if len(chosen[name]) > 1 and name != across]
    by_labels: dict[tuple[Any, ...], dict[Any, dict[str, Value]]] = {}
    place = {name: {level: number for number, level in enumerate(levels)} for name, levels in chosen.items()}
    whole = [name for name, levels in chosen.items() if ALL in levels]
    sums = [frozenset(names) for n in range(len(whole) + 1) for names in combinations(whole, n)]
    found_rows = [row for pooled in sums for row in rows_of(document, pooled)]
    rows = [row for row in found_rows if all(row[name] in levels for name, levels in chosen.items())]
    for row in sorted(rows, key=lambda row: [place[name][row[name]] for name in axes]):
        figures = _figures(row, by_heading(columns).values(), axes)
        by_labels.setdefault(tuple(row[name] for name in names), {})[row.get(across)] = figures
    if not by_labels:
        raise Refused(f"{document.name} has no such rows")
    labels = [[chosen[name][level] for name, level in zip(names, levels, strict=True)] for levels in by_labels]
    if not across:
        every = [figures[None] for figures in by_labels.values()]
        headings, cells = table_of(columns, every, {column: _label(column) for column in every[0]}, digits)
    else:
        ((heading, name),) = by_heading(columns).items()
        unit = UNIT.search(heading)
        headings = list(chosen[across].values())
        of = [
            [row[level][name] if level in row else Value("") for level in chosen[across]] for row in by_labels.values()
        ]
        cells = [[one.text(digits, unit["unit"] if unit else None) for one in row] for row in of]
    return [*(axes[name].label for name in names), *headings], [[*a, *b] for a, b in zip(labels, cells, strict=True)]


def page_table(document: Kept) -> Rows:
    """Return the table of a sweep's page: every outcome, and what it shows, without columns that no row has."""
    asked = [*ENDS, *(name for shown in document.shows for name in SHOWN[shown][0])]
    rows = rows_of(document)
    return sweep_table(document, [name for name in asked if any(row.get(name, True) for row in rows)], {}, digits=3)


# --- studies ----------------------------------------------------------------------------------------------------------


def study_table(document: Kept, columns: Names, chosen: Names, digits: int = 2) -> Rows:
    """Return a row for each case, or without columns for each figure of a study that has no case.

    A cell is empty where a case lacks a figure that another one has.
    """
    cases = cases_of(document.summary)
    if not columns:
        figures, cells = cases[""], []
        for text, name in by_heading(chosen or list(figures)).items():
            value, unit = one(figures, name, "figure"), _unit(text)
            cells.append([UNIT.sub("", text), f"{Value(value, _unit(name)).text(digits, unit)} {unit}".rstrip()])
        return ["figure", "value"], cells
    asked = by_heading(chosen or [case for case in cases if case])
    held = [one(cases, name, "case") for name in asked.values()]
    labels = {figure: UNIT.sub("", figure) for figures in held for figure in figures}
    rows = [{figure: Value(figures.get(figure), _unit(figure)) for figure in labels} for figures in held]
    headings, cells = table_of(columns, rows, labels, digits)
    return ["", *headings], [[text, *row] for text, row in zip(asked, cells, strict=True)]


def _unit(figure: str) -> str:
    """Return the unit that ends the name of a figure."""
    match = UNIT.search(figure)
    return match["unit"].translate(SIGNS).replace("degree", "°").replace("deg", "°") if match else ""
