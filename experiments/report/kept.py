"""Kept results: `docs/results/NAME.json`, the figures of a finished result, and the page that shows them.

A kept result has what its pages say: how it was made, and its figures. Those of a sweep are rows of flights, also
pooled over any of its axes; those of a study or a benchmark are its summary.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from experiments import Refused
from experiments.report.findings import Finding
from experiments.report.page import Heading, Mark, Page, Picture, Table, Text
from experiments.sweep.intervals import wilson
from jax_aero.base import places
from jax_aero.base.files import read_json
from jax_aero.rust import MODES

FOLDER = places.HOME / "docs" / "results"
INDEX = "index"
"""Name of the page that lists all kept results."""

ALL = "all"
"""Level of an axis over which the flights of a row are pooled."""


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
    """Outcome and figures (`keep.FIRST`) of the first flight of each cell, in the order of the sweep's cells.

    Empty where the cell's controller is in Python.
    """
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
        flown = table(kept)
        shown.add(Text(_outcomes(kept)), flown, Text(_legend(kept, flown.headings)))
    if kept.summary is not None:
        shown.add(*_summary(kept.summary))
    if kept.claims:
        rows = [
            (kept.states[key], finding.measured, Mark(str(finding.verdict), finding.verdict.tone))
            for key, finding in kept.claims.items()
        ]
        shown.add(Heading(2, "Claims"), Table(("claim", "measured", "verdict"), rows))
    if (FOLDER / f"{kept.name}.webp").is_file():
        shown.add(Picture(f"{kept.name}.webp", kept.title))
    again = f" The first flight of each cell: {kept.firsts_flown}." if kept.firsts_flown else ""
    shown.add(Heading(2, "How it was made"), Text(f"`{kept.command}`; {_made(kept)}.{again}"))
    return shown


def _made(kept: Kept) -> str:
    unknown = f", code {kept.code} of a commit that is not in the history"
    commit = f", commit {kept.commit[:10]}" if kept.commit else unknown
    seed = "" if kept.seed is None else f", seed {kept.seed}"
    return f"{kept.created[:10]}{commit}{seed}"


def _outcomes(kept: Kept) -> str:
    counted = ", ".join(f"{number} {outcome.replace('_', ' ')}" for outcome, number in kept.outcomes.items() if number)
    return f"{sum(kept.outcomes.values())} flights ({kept.each}): {counted}."


def table(kept: Kept) -> Table:
    """Return the table of a sweep: one quantity a column, without those that no row has."""
    axes = sorted(kept.axes, key=lambda axis: axis.name == kept.panels)
    found = {tuple(row[axis.name] for axis in axes): row for row in kept.table()}
    shown = [levels for levels in itertools.product(*(axis.levels for axis in axes)) if levels in found]
    columns = {heading: [of(found[levels]) for levels in shown] for heading, of in _quantities(kept).items()}
    held = {heading: cells for heading, cells in columns.items() if any(cells)}
    labels = [_labels(axes, levels, before) for before, levels in zip([(), *shown], shown, strict=False)]
    rows = [[*label, *cells] for label, *cells in zip(labels, *held.values(), strict=True)]
    return Table([*(axis.label for axis in axes), *held], rows)


def _labels(axes: Sequence[Axis], levels: Sequence[Any], before: Sequence[Any]) -> list[str]:
    """Return the levels of a row, without those that repeat the row before."""
    same = 0
    while same < len(axes) - 1 and [*levels[: same + 1]] == [*before[: same + 1]]:
        same += 1
    return [""] * same + [axis.show(level) for axis, level in zip(axes[same:], levels[same:], strict=True)]


Quantity = Callable[[Mapping[str, Any]], str]
SHARE = "share [%]"
EXPLAINED = {
    SHARE: "Share: of flights that completed or descended, with its Wilson 95 % interval.",
    "rotation error [°]": "Errors: the greatest of a flight that completed or descended; median, and at most.",
    "found after [s]": "Found after: median time since the failure, where half of the flights find one.",
    "announced before [s]": "Announced before: median time from the first mode to the loss.",
    "modes": "Modes: those of at least half of the flights.",
}


def _quantities(kept: Kept) -> dict[str, Quantity]:
    """Return what a table shows of a row, by heading."""

    def count(name: str) -> Quantity:
        return lambda row: str(row.get(name) or ("0" if name == "completed" else ""))

    def number(name: str) -> Quantity:
        return lambda row: _number(row[name])

    counts = ("flights", "completed", "descended", "descending", "off_course", "crashed")
    found: dict[str, Quantity] = {name.replace("_", " "): count(name) for name in counts}
    found["fell"] = lambda row: str(row["lost"] - row.get("crashed", 0) or "")
    if "share" in kept.shows:
        found[SHARE] = _share
    if "errors" in kept.shows:
        found |= {"rotation error [°]": number("rotation_deg_median"), "at most [°]": number("rotation_deg_worst")}
        found |= {"position error [cm]": number("com_cm_median"), "at most [cm]": number("com_cm_worst")}
    if "found" in kept.shows:
        found["found after [s]"] = lambda row: _number(row["found_s"]) if 2 * row["degraded"] >= row["flights"] else ""
    if "announced" in kept.shows:
        found["announced before [s]"] = number("announced_s")
    if "modes" in kept.shows:
        found["modes"] = lambda row: " ".join(f"`{name}`" for name, bit in MODES.items() if row["modes"] & bit)
    return found


def _share(row: Mapping[str, Any]) -> str:
    done, flights = row["completed"] + row["descended"], row["flights"]
    share, low, high = (f"{100.0 * x:.0f}" for x in (done / flights, *wilson(done, flights)))
    return f"{share} ({low} to {high})"


def _number(value: float | None) -> str:
    """Return a number with two or three digits."""
    if value is None:
        return ""
    return f"{value:.2f}" if value < 1.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"


def _legend(kept: Kept, headings: Sequence[str]) -> str:
    said = ["Counts that are empty are 0.", *(text for heading, text in EXPLAINED.items() if heading in headings)]
    if kept.outcomes.get("diverged"):
        said.append(f"Of those that fell {kept.outcomes['diverged']} diverged.")
    if kept.pooled:
        said.append(f"Pooled over {', '.join(kept.pooled)}.")
    return " ".join(said)


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
