"""Kept results: `docs/results/NAME.json`, the figures of a finished result, and the page that shows them.

A kept result has what its pages say: how it was made, and its figures. Those of a sweep are rows of flights, also
pooled over any of its axes; those of a study or a benchmark are its summary.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec

from experiments import Refused
from experiments.report.findings import Finding
from experiments.report.page import Heading, Mark, Page, Picture, Table, Text
from experiments.report.verdicts import Kind
from jax_aero.base import places
from jax_aero.base.files import read_json
from jax_aero.base.modes import MODES

FOLDER = places.HOME / "docs" / "results"
INDEX = "index"
"""Name of the page that lists all kept results."""

ALL = "all"
"""Level of an axis over which the flights of a row are pooled."""

MOST_COLUMNS = 6
"""Greatest number of levels of the first axis for which they are columns, if the sweep has no panels."""


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
    code: str
    """Digest of the code."""
    config: dict[str, Any] = {}
    """Configuration of a study; that of a sweep is its file."""
    seed: int | None = None
    each: str = ""
    """Number of flights of a cell, and how they differ."""
    axes: list[Axis] = []
    drawing: str = ""
    panels: str = ""
    pooled: list[str] = []
    """Labels of the axes that no row distinguishes."""
    shows: list[str] = []
    outcomes: dict[str, int] = {}
    """Number of flights by outcome."""
    columns: list[str] = []
    rows: list[list[Any]] = []
    """Figures of flights; an axis over which they are pooled is "all"."""
    firsts: list[list[Any]] = []
    """Outcome and figures (`keep.FIRST`) of the first flight of each cell, in the order of the sweep's cells."""
    firsts_flown: str = ""
    """When and with which commit these were flown, if not with the other flights."""
    claims: dict[str, Finding] = {}
    states: dict[str, str] = {}
    """What the claims say."""
    summary: Any = None
    """Figures of a study or a benchmark."""

    def table(self) -> list[dict[str, Any]]:
        """Return the rows as tables."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


def names() -> list[str]:
    """Return the names of all kept results."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


@cache
def read(name: str) -> Kept:
    """Return a kept result."""
    path = FOLDER / f"{name}.json"
    if not path.is_file():
        raise Refused(f"there is no kept result `{name}`{places.did_you_mean(name, names())}")
    return msgspec.convert(read_json(path, Kept), Kept)


def findings() -> dict[str, Finding]:
    """Return the findings of all claims of kept sweeps."""
    return {key: finding for name in names() for key, finding in read(name).claims.items()}


def to_json(kept: Kept) -> str:
    """Return a kept result as JSON, with a line for each row."""
    document = msgspec.to_builtins(kept)
    tables = {name: document.pop(name) for name in ("rows", "firsts") if name in document}
    text = json.dumps(document, indent=1, ensure_ascii=False)
    for name, rows in tables.items():
        lines = ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in rows)
        text = f'{text[:-2]},\n "{name}": [\n{lines}\n ]\n}}'
    return f"{text}\n"


# --- the page --------------------------------------------------------------------------------------------------------


def pages() -> dict[Path, str]:
    """Return the pages of all kept results, and the page that lists them, by path."""
    listed = Page("Kept results")
    rows = [(f"[{kept.name}]({kept.name}.md)", kept.title, _made(kept)) for kept in map(read, names())]
    listed.add(
        Text(
            "Results that the documentation speaks of: figures, picture, and how each was made. "
            "`jax-aero report keep NAME` writes one; nothing here is written by hand."
        ),
        Table(("result", "shows", "made"), rows),
    )
    found = {FOLDER / f"{INDEX}.md": listed.markdown()}
    return found | {FOLDER / f"{name}.md": page(read(name)).markdown() for name in names()}


def page(kept: Kept) -> Page:
    """Return the page of a kept result."""
    shown = Page(kept.title)
    if kept.about:
        shown.add(Text(kept.about))
    if kept.rows:
        shown.add(Text(_outcomes(kept)), table(kept), Text(_legend(kept)))
    if kept.summary is not None:
        shown.add(*_summary(kept.summary))
    if kept.claims:
        rows = [
            (kept.states[key], finding.measured, Mark(str(finding.verdict), _tone(finding)))
            for key, finding in kept.claims.items()
        ]
        shown.add(Heading(2, "Claims"), Table(("claim", "measured", "verdict"), rows))
    if (FOLDER / f"{kept.name}.webp").is_file():
        shown.add(Picture(f"{kept.name}.webp", kept.title))
    again = f" The first flight of each cell: {kept.firsts_flown}." if kept.firsts_flown else ""
    shown.add(Heading(2, "How it was made"), Text(f"`{kept.command}`; {_made(kept)}.{again}"))
    return shown


def _tone(finding: Finding) -> Literal["good", "bad"]:
    return "good" if finding.verdict.kind is Kind.AGREES else "bad"


def _made(kept: Kept) -> str:
    unknown = f", code {kept.code} of a commit that is not in the history"
    commit = f", commit {kept.commit[:10]}" if kept.commit else unknown
    seed = "" if kept.seed is None else f", seed {kept.seed}"
    return f"{kept.created[:10]}{commit}{seed}"


def _outcomes(kept: Kept) -> str:
    counted = ", ".join(f"{number} {outcome.replace('_', ' ')}" for outcome, number in kept.outcomes.items() if number)
    is_old = kept.outcomes.get("descended") and "crashed" not in kept.outcomes
    known = (
        " Flown before crashes were told from landings: *descended* is every flight that was given up and did not fall."
    )
    return f"{sum(kept.outcomes.values())} flights ({kept.each}): {counted}.{known if is_old else ''}"


def table(kept: Kept) -> Table:
    """Return the table of a sweep: its panels side by side."""
    across = next((axis for axis in kept.axes if axis.name == kept.panels), None)
    if across is None and len(kept.axes) > 1 and len(kept.axes[0].levels) <= MOST_COLUMNS:
        across = kept.axes[0]
    down = [axis for axis in kept.axes if axis is not across]
    found = {tuple(row[axis.name] for axis in kept.axes): row for row in kept.table()}
    parts = _parts(kept)

    def cell(levels: Mapping[str, Any]) -> str:
        row = found.get(tuple(levels[axis.name] for axis in kept.axes))
        return "" if row is None else ", ".join(filter(None, (part(row) for part in parts)))

    columns = [{}] if across is None else [{across.name: level} for level in across.levels]
    headings = ["flights"] if across is None else [across.show(level) for level in across.levels]
    combined = list(_combine(down))
    shown = [each for each in combined if any(map(cell, ({**each, **column} for column in columns)))]
    rows = [
        [*_labels(down, each, before), *(cell({**each, **column}) for column in columns)]
        for before, each in zip([{}, *shown], shown, strict=False)
    ]
    return Table([*(axis.label for axis in down), *headings], rows)


def _combine(axes: Sequence[Axis]) -> Iterator[dict[str, Any]]:
    if not axes:
        yield {}
        return
    first, *others = axes
    for level in first.levels:
        for rest in _combine(others):
            yield {first.name: level, **rest}


def _labels(axes: Sequence[Axis], levels: Mapping[str, Any], before: Mapping[str, Any]) -> Iterator[str]:
    """Yield the levels of a row, without those that repeat the row before."""
    is_same = True
    for axis in axes:
        is_same = is_same and before.get(axis.name) == levels[axis.name] and axis is not axes[-1]
        yield "" if is_same else axis.show(levels[axis.name])


def _parts(kept: Kept) -> list[Callable[[Mapping[str, Any]], str]]:
    """Return the functions from a row to the parts of its cell."""
    known = {"errors": _errors, "found": _found, "announced": _announced, "modes": _modes}
    return [_count, *(part for name, part in known.items() if name in kept.shows)]


def _count(row: Mapping[str, Any]) -> str:
    """Return the flights that complete, and those that land."""
    down = f" + {row['descended']}" if row["descended"] else ""
    others = (
        f"{row[end]} {word}" for end, word in (("descending", "still descend"), ("crashed", "crash")) if row.get(end)
    )
    return ", ".join([f"{row['completed']}{down} of {row['flights']}", *others])


def _errors(row: Mapping[str, Any]) -> str:
    angle, distance = row["rotation_deg_median"], row["com_cm_median"]
    if angle is None:
        return ""
    if row["completed"] + row["descended"] == 1:
        return f"{_number(angle)}°, {_number(distance)} cm"
    worst_angle, worst_distance = row["rotation_deg_worst"], row["com_cm_worst"]
    return f"{_number(angle)}° ({_number(worst_angle)}), {_number(distance)} cm ({_number(worst_distance)})"


def _number(value: float | None) -> str:
    """Return a number with two or three digits."""
    if value is None:
        return "–"
    return f"{value:.2f}" if value < 1.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"


def _found(row: Mapping[str, Any]) -> str:
    is_usual = 2 * row["degraded"] >= row["flights"] and row["found_s"] is not None
    return f"found after {row['found_s']:.2f} s" if is_usual else ""


def _announced(row: Mapping[str, Any]) -> str:
    return "" if row["announced_s"] is None else f"announced {row['announced_s']:.2f} s before"


def _modes(row: Mapping[str, Any]) -> str:
    return " ".join(f"`{name}`" for name, bit in MODES.items() if row["modes"] & bit)


def _legend(kept: Kept) -> str:
    said = ["Flights that complete" + (" + land" if kept.outcomes.get("descended") else "")]
    if "errors" in kept.shows:
        said.append("median (greatest) of their greatest rotation and position errors")
    if "found" in kept.shows:
        said.append("median time after which a failure is found, where half of the flights find one")
    if "announced" in kept.shows:
        said.append("median time from the announcement of a loss to the loss")
    if "modes" in kept.shows:
        said.append("modes of at least half of the flights")
    pooled = f" Pooled over {', '.join(kept.pooled)}." if kept.pooled else ""
    return "; ".join(said) + "." + pooled


def _summary(summary: Any) -> Iterator[Text | Table]:
    """Yield a text as it is, and figures as tables: one of plain ones, one for cases with the same figures.

    The cases of a study are nested tables, or the first part of the names: `fine mesh: drag [m2]`.
    """
    if isinstance(summary, str):
        yield Text(summary)
        return
    plain: dict[str, Any] = {}
    cases: dict[str, dict[str, Any]] = {}
    for key, value in summary.items():
        case, separator, figure = str(key).rpartition(": ")
        if isinstance(value, Mapping):
            cases.setdefault(str(key), {}).update(value)
        elif separator:
            cases.setdefault(case, {})[figure] = value
        else:
            plain[str(key)] = value
    if plain:
        yield Table(("figure", "value"), [(key, _plain(value)) for key, value in plain.items()])
    by_figures: dict[tuple[str, ...], list[str]] = {}
    for case, figures in cases.items():
        by_figures.setdefault(tuple(figures), []).append(case)
    for columns, names in by_figures.items():
        yield Table(("case", *columns), [(case, *map(_plain, cases[case].values())) for case in names])


def _plain(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
