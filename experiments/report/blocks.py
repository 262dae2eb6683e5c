"""Tables of pages, written from what they show: kept results, claims, flights, configurations.

A page has a block between two comments, the first of which is TOML:

```text
<!-- table
kept = "robot_missions"
columns = ["completed", "rotation_deg_worst"]
-->
<!-- end -->
```

`make generated` writes the table between them. Names are those of the files; `{ "heading" = "name" }` in place of
`["name"]` gives them other words, and a heading that ends in another unit, such as `[mm]`, converts to it.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from experiments import Refused, schema, studies
from experiments.report import command, kept, paper
from experiments.report.kept import ALL, Kept
from experiments.report.page import table
from experiments.sweep.intervals import wilson
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.quantities import shown
from jax_aero.base.result import ending

BLOCK = re.compile(r"^<!-- table\n(?P<asks>.*?)^-->\n.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)
UNIT = re.compile(r"\s*\[(?P<unit>[^\]]+)\]$")
SIGNS = str.maketrans("234", "²³⁴")
FACTORS = {
    "°": ("rad", math.radians(1.0)), "rad": ("rad", 1.0), "%": ("", 0.01), "": ("", 1.0),
    "km": ("m", 1e3), "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "µm": ("m", 1e-6),
    "h": ("s", 3600.0), "min": ("s", 60.0), "s": ("s", 1.0), "ms": ("s", 1e-3), "µs": ("s", 1e-6),
    "°/s": ("rad/s", math.radians(1.0)), "rad/s": ("rad/s", 1.0),
}  # fmt: skip
"""Units that can be converted: the one of the SI, and the factor."""

Names = list[str] | dict[str, str]
"""Names, or names by what a table says in their place."""
T = TypeVar("T")


class Asked(msgspec.Struct, forbid_unknown_fields=True):
    """What a block shows: one of `kept`, `claims`, `flights` and `config`."""

    kept: str = ""
    """A kept result."""
    claims: Names = []
    """Keys of claims, of the paper's table or of a sweep."""
    flights: Names = []
    """Experiments, which are flown."""
    config: str = ""
    """A file of `configs`: `control/observer`."""
    rows: Any = {}
    """Of a sweep: levels by axis, all of an axis that is left out; of a study: cases; of a configuration: its keys."""
    across: str = ""
    """Axis of a sweep whose levels are columns, of one quantity."""
    columns: Names = []
    digits: int = 2
    """Least number of significant digits of a measured number; those before the point are all shown."""


class Value(NamedTuple):
    """A number with its unit, or a text."""

    value: Any
    unit: str = ""

    def text(self, digits: int, unit: str | None = None) -> str:
        """Return it in a unit."""
        if self.value is None or self.value != self.value:
            return ""
        if isinstance(self.value, str):
            return self.value
        value = self.value if unit in (None, self.unit) else converted(self.value, self.unit, unit)
        if isinstance(value, float):
            before = math.floor(math.log10(abs(value))) if value else 0
            return f"{value:.{max(0, digits - 1 - before)}f}".replace("-", "−")
        return str(value)


def converted(value: float, unit: str, to: str) -> float:
    """Return a number in another unit."""
    (base, factor), (other, divisor) = (FACTORS.get(one, (one, 1.0)) for one in (unit, to))
    if base != other:
        raise Refused(f"{unit or 'a number without unit'} is no {to}")
    return value * factor / divisor


def files() -> dict[Path, str]:
    """Return every page that has a block, as it should be."""
    texts = {path: path.read_text(encoding="utf-8") for path in pages()}
    return {path: written(text, path) for path, text in texts.items() if BLOCK.search(text)}


def pages() -> list[Path]:
    """Return the pages that are written by hand."""
    docs = [path for path in sorted((places.HOME / "docs").rglob("*.md")) if path.parent != kept.FOLDER]
    own = [places.HOME / "README.md", places.HOME / "CONTRIBUTING.md"]
    return [*own, *docs, *sorted(studies.FOLDER.glob("*/README.md"))]


def written(text: str, path: Path) -> str:
    """Return a page with its tables."""

    def write(block: re.Match[str]) -> str:
        line = text.count("\n", 0, block.start()) + 1
        try:
            asked = msgspec.convert(tomllib.loads(block["asks"]), Asked)
            return f"<!-- table\n{block['asks']}-->\n{shows(asked)}\n<!-- end -->"
        except (tomllib.TOMLDecodeError, msgspec.ValidationError, ValueError) as reason:
            raise Refused(f"{path}:{line}: {reason}") from None

    if text.count("<!-- table") != len(BLOCK.findall(text)):
        raise Refused(f"{path}: a table is not between `<!-- table`, `-->` and `<!-- end -->`, each a line of its own")
    return BLOCK.sub(write, text)


def shows(asked: Asked) -> str:
    """Return the table that a block asks for."""
    sources = {"kept": _of_kept, "claims": _of_claims, "flights": _of_flights, "config": _of_config}
    named = [source for source in sources if getattr(asked, source)]
    if len(named) != 1:
        raise Refused(f"a table shows {' and '.join(named) or 'nothing'}; expected one of {', '.join(sources)}")
    headings, rows = sources[named[0]](asked)
    return table(rows, *headings)


Rows = tuple[list[str], list[list[str]]]
"""Headings and cells."""


def _by_heading(names: Names) -> dict[str, str]:
    return names if isinstance(names, dict) else {name: name for name in names}


def _one(known: Mapping[str, T], name: str, what: str) -> T:
    if name not in known:
        raise Refused(f"there is no {what} `{name}`{places.did_you_mean(name, known)}")
    return known[name]


def _columns(names: Names, rows: Sequence[Mapping[str, Value]], labels: Mapping[str, str], digits: int) -> Rows:
    """Return headings with units, and the cells below them; a column has one unit."""
    headings, columns = [], []
    for heading, name in _by_heading(names).items():
        values = [_one(row, name, "column") for row in rows]
        unit = next((value.unit for value in values if value.unit), "")
        if heading == name:
            heading = labels.get(name, name)
        if found := UNIT.search(heading):
            unit, heading = found["unit"], heading[: found.start()]
        headings.append(f"{heading} [{unit}]" if unit else heading)
        columns.append([value.text(digits, None if isinstance(value.value, str) else unit) for value in values])
    return headings, [list(cells) for cells in zip(*columns, strict=True)]


# --- kept results -----------------------------------------------------------------------------------------------------


def _of_kept(asked: Asked) -> Rows:
    document = kept.read(asked.kept)
    return _of_sweep(document, asked) if document.rows else _of_study(document, asked)


STATISTICS = {"median": "median", "high": "90 %", "worst": "greatest"}
QUANTITIES = {
    "rotation_deg": "rotation error",
    "com_cm": "position error",
    "found_s": "found after",
    "announced_s": "announced before",
    "lost_s": "lost at",
}
UNITS = {"deg": "°", "cm": "cm", "s": "s"}


def _label(column: str) -> str:
    """Return the heading of a column: `rotation_deg_worst` is "rotation error, greatest"."""
    quantity, _, statistic = column.rpartition("_")
    if statistic in STATISTICS:
        return f"{QUANTITIES[quantity]}, {STATISTICS[statistic]}"
    return QUANTITIES.get(column, column.replace("_", " "))


def _figures(row: Mapping[str, Any], axes: Sequence[str]) -> dict[str, Value]:
    """Return the figures of a row; a count with its flights, also of several outcomes: `completed + landed`."""
    found = {"flights": Value(row["flights"])}
    for column in row.keys() - {*axes, "flights"}:
        unit = next((UNITS[part] for part in column.split("_") if part in UNITS), None)
        if column == "modes":
            found[column] = Value(" ".join(f"`{name}`" for name, bit in rust.MODES.items() if row[column] & bit))
        elif unit is None:
            found[column] = Value(f"{row[column]} of {row['flights']}")
        else:
            found[column] = Value(row[column], unit)
    return found


def _combined(name: str, row: Mapping[str, Any], figures: dict[str, Value]) -> None:
    """Add a sum of counts, `completed + landed`, or a share with its Wilson interval of 95 %, `share completed`."""
    counts = re.sub(r"^share ", "", name).split(" + ")
    if name not in figures and all(isinstance(row.get(count), int) for count in counts):
        count, flights = sum(row[count] for count in counts), row["flights"]
        share, low, high = (f"{100.0 * x:.0f}" for x in (count / flights, *wilson(count, flights)))
        is_share = name.startswith("share ")
        figures[name] = Value(f"{share} % ({low} to {high})" if is_share else f"{count} of {flights}")


def _of_sweep(document: Kept, asked: Asked) -> Rows:
    """Return a row for each combination of levels; an axis of one level has no column."""
    axes = {axis.name: axis for axis in document.axes}
    if not isinstance(asked.rows, dict):
        raise Refused(f"rows is {asked.rows}; expected levels by axis: {', '.join(axes)}")
    for name in (*asked.rows, *([asked.across] if asked.across else [])):
        _one(axes, name, "axis")
    chosen: dict[str, dict[Any, str]] = {}
    for name, axis in axes.items():
        level_of = {axis.show(level): level for level in axis.levels} | {ALL: ALL}
        levels = asked.rows.get(name, list(map(axis.show, axis.levels)))
        said = _by_heading([levels] if isinstance(levels, str) else levels)
        chosen[name] = {_one(level_of, level, f"level of {name}"): text for text, level in said.items()}
    names = [name for name in axes if len(chosen[name]) > 1 and name != asked.across]
    found: dict[tuple[Any, ...], dict[Any, dict[str, Value]]] = {}
    place = {name: {level: number for number, level in enumerate(levels)} for name, levels in chosen.items()}
    rows = [row for row in document.table() if all(row[name] in levels for name, levels in chosen.items())]
    for row in sorted(rows, key=lambda row: [place[name][row[name]] for name in axes]):
        figures = _figures(row, list(axes))
        for name in _by_heading(asked.columns).values():
            _combined(name, row, figures)
        found.setdefault(tuple(row[name] for name in names), {})[row.get(asked.across)] = figures
    if not found:
        raise Refused(f"{document.name} has no such rows")
    labels = [[chosen[name][level] for name, level in zip(names, levels, strict=True)] for levels in found]
    if not asked.across:
        every = [figures[None] for figures in found.values()]
        headings, cells = _columns(asked.columns, every, {column: _label(column) for column in every[0]}, asked.digits)
    else:
        ((heading, name),) = _by_heading(asked.columns).items()
        levels = chosen[asked.across]
        unit = UNIT.search(heading)
        headings = list(levels.values())
        of = [[row[level][name] if level in row else Value("") for level in levels] for row in found.values()]
        cells = [[one.text(asked.digits, unit["unit"] if unit else None) for one in row] for row in of]
    return [*(axes[name].label for name in names), *headings], [[*a, *b] for a, b in zip(labels, cells, strict=True)]


def _of_study(document: Kept, asked: Asked) -> Rows:
    """Return a row for each case, or for each figure of a study without cases or of the case `columns`."""
    cases = kept.cases_of(document.summary)
    if not asked.columns:
        figures = cases.get("", {})
        chosen = _by_heading(asked.rows or list(figures))
        values = [(text, _with_unit(name, _one(figures, name, "figure"))) for text, name in chosen.items()]
        cells = []
        for text, value in values:
            found = UNIT.search(text)
            unit = found["unit"].translate(SIGNS) if found else value.unit
            cells.append([UNIT.sub("", text), f"{value.text(asked.digits, unit)} {unit}".rstrip()])
        return ["figure", "value"], cells
    chosen = _by_heading(asked.rows or [case for case in cases if case])
    held = [_one(cases, name, "case") for name in chosen.values()]
    rows = [{figure: _with_unit(figure, value) for figure, value in figures.items()} for figures in held]
    labels = {figure: UNIT.sub("", figure) for row in rows for figure in row}
    headings, cells = _columns(asked.columns, rows, labels, asked.digits)
    return ["", *headings], [[text, *row] for text, row in zip(chosen, cells, strict=True)]


def _with_unit(figure: str, value: Any) -> Value:
    found = UNIT.search(figure)
    return Value(value, found["unit"].translate(SIGNS).replace("deg", "°") if found else "")


# --- claims, flights, configurations ----------------------------------------------------------------------------------


def _of_claims(asked: Asked) -> Rows:
    found, claims = command.documented(), paper.all_claims()
    rows = []
    for text, key in _by_heading(asked.claims).items():
        states, finding = _one(claims, key, "claim").states, _one(found, key, "finding of the claim")
        said = {"claim": states if text == key else text, "measured": finding.measured, "verdict": str(finding.verdict)}
        rows.append({name: Value(cell) for name, cell in said.items()})
    return _columns(asked.columns or ["claim", "verdict"], rows, {}, asked.digits)


def _of_flights(asked: Asked) -> Rows:
    rows = []
    for name in _by_heading(asked.flights).values():
        _one(dict.fromkeys(places.names("experiments")), name, "experiment")
        config, flight = _flown(name)
        row = {"title": Value(config["title"]), "lost_time": Value(flight.lost_time, "s")}
        row["outcome"] = Value(ending(flight.outcome, flight.lost_time, flight.lost_reason))
        for figure, declared in rust.figures().items():
            number = shown(declared, flight.summary.get(figure, math.nan))
            row[figure] = Value(number.values, number.unit.replace("deg", "°"))
        rows.append(row)
    labels = {name: figure.label for name, figure in rust.figures().items()} | {"lost_time": "lost at"}
    headings, cells = _columns(asked.columns, rows, labels, asked.digits)
    texts = [f"`{name}`" if text == name else text for text, name in _by_heading(asked.flights).items()]
    return ["flight", *headings], [[text, *row] for text, row in zip(texts, cells, strict=True)]


@cache
def _flown(name: str) -> tuple[Mapping[str, Any], rust.FlightResult]:
    config = rust.load_config(name)
    return config, rust.fly(config)


def _of_config(asked: Asked) -> Rows:
    folder, _, name = asked.config.partition("/")
    node = _one(rust.schemas(), folder, "folder of configs with keys")
    table = rust.read_table(places.find(folder, name), node, {})
    keys = _by_heading(asked.rows)
    rows = []
    for text, key in keys.items():
        value: Any = table
        for part in key.split("."):
            value = _one(value, part, "key") if isinstance(value, Mapping) else _one({}, part, "key")
        meaning, unit = schema.described(node, key)
        cells = {"key": f"`{key}`" if text == key else text, "value": f"{_plain(value)} {unit}".rstrip()}
        rows.append({column: Value(cell) for column, cell in (cells | {"meaning": meaning}).items()})
    return _columns(asked.columns or ["key", "value"], rows, {}, asked.digits)


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return f"({', '.join(map(_plain, value))})"
    return (
        f"{value:g}".replace("-", "−") if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
    )
