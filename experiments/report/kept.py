"""Kept results: `docs/results/NAME.json`, the figures of a finished result, and the page that shows them.

A kept result has what its pages say: how it was made, and its figures. Those of a sweep are rows of flights, also
pooled over any of its axes; those of a study or a benchmark are its summary.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from functools import cache
from typing import Any

import msgspec

from experiments import Refused, outdated
from experiments.report import judge, paper
from experiments.report.judge import Finding, Kind, Verdict
from experiments.report.measures.results import of_cells
from experiments.report.page import markdown
from experiments.report.results import ANOTHER
from experiments.sweep.criteria import Criterion
from experiments.sweep.intervals import wilson
from jax_aero.base import places
from jax_aero.base.files import read_json
from jax_aero.rust import MODES

FOLDER = places.HOME / "docs" / "results"
MOST_LEVELS = 16
"""Greatest number of levels that are drawn in rows: the picture of more repeats the table."""

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
    numerics: dict[str, int] = {}
    """Versions of the numbers of what computed it (`experiments.identity`); the first ones if none is named."""
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

    Empty where MuJoCo simulates or the controller is in Python.
    """
    firsts_flown: str = ""
    """When and with which commit these were flown, if not with the other flights."""
    summary: Any = None
    """Figures of a study or a benchmark."""

    def table(self) -> list[dict[str, Any]]:
        """Return the rows as tables."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]

    def cells(self, pooled: Set[str] = frozenset()) -> list[dict[str, Any]]:
        """Return the rows with the columns of a sweep's table of cells, pooled over these axes and no others."""
        found = [row for row in self.table() if {axis.name for axis in self.axes if row[axis.name] == ALL} == pooled]
        return [row | _as_cell(row) for row in found]

    @property
    def is_drawn(self) -> bool:
        """Whether a picture adds to the table, and needs no more than its rows."""
        if self.drawing in ("levels", "front"):
            return all(len(axis.levels) <= MOST_LEVELS for axis in self.axes)
        return self.drawing in ("curve", "map") and not self.pooled

    @property
    def stated(self) -> dict[str, Criterion]:
        """Return the claims in the file of its sweep, by key."""
        _, _, name = self.result.partition("/")
        return {one.key: one for one in paper.stated(name)} if self.rows and name in places.names("sweeps") else {}

    @property
    def claims(self) -> dict[str, Finding]:
        """Return what its rows say of these claims, by today's judge; outdated if its sweep is another by now."""
        differs = _differs(self.result, self.digest, tuple(self.numerics.items())) if self.stated else ""
        return {key: self._find(one, differs) for key, one in self.stated.items()}

    def _find(self, asked: Criterion, differs: str) -> Finding:
        axes = [axis.name for axis in self.axes]
        pooled = {*axes} - {*asked.cells} if asked.share else set()
        found = of_cells([cell for cell in self.cells(pooled) if asked.covers(cell)], axes, asked)
        verdict = judge.of_sweep(self.name, asked).judge(found.cases)
        if differs:
            return Finding(f"{found.text}; {ANOTHER}: {differs}", Verdict.of(Kind.OUTDATED, verdict.text), self.commit)
        return Finding(found.text, verdict, self.commit)


def _as_cell(row: Mapping[str, Any]) -> dict[str, Any]:
    cell: dict[str, Any] = {"upright": row["completed"] + row["landed"]}
    for share, count in {"completed": row["completed"], **cell}.items():
        cell[f"{share}_low"], cell[f"{share}_high"] = wilson(count, row["flights"])
    for quantity, column, factor in (("rotation_error_deg", "rotation_deg", 1.0), ("com_error", "com_cm", 0.01)):
        for quantile, of in (("p10", "median"), ("median", "median"), ("p90", "high"), ("worst", "worst")):
            value = row[f"{column}_{of}"]
            cell[f"{quantity}_{quantile}"] = None if value is None else factor * value
    return cell


@cache
def _differs(result: str, digest: str, numerics: tuple[tuple[str, int], ...]) -> str:
    return outdated.sweep(places.RESULTS / result, {"config_digest": digest, "numerics": dict(numerics)})


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


def pages() -> dict[str, str]:
    """Return the pages of all kept results by file name, and the page that lists them."""
    rows = [(f"[{kept.name}]({kept.name}.md)", kept.title, _made(kept)) for kept in map(read, names())]
    return {"index.md": markdown("kept_index.md", rows=rows)} | {f"{name}.md": page(read(name)) for name in names()}


def page(kept: Kept) -> str:
    """Return the page of a kept result, as Markdown."""
    flown = table(kept) if kept.rows else [[]]
    counted = ", ".join(f"{number} {outcome.replace('_', ' ')}" for outcome, number in kept.outcomes.items() if number)
    return markdown(
        "kept.md",
        kept=kept,
        outcomes=f"{sum(kept.outcomes.values())} flights ({kept.each}): {counted}.",
        flown=flown,
        legend=_legend(kept, flown[0]),
        summary=list(_summary(kept.summary)),
        claims=[(kept.stated[key].states, one.measured, f"**{one.verdict}**") for key, one in kept.claims.items()],
        picture=f"{kept.name}.webp" if kept.is_drawn else "",
        made=_made(kept),
        again=_again(kept),
    )


def _again(kept: Kept) -> str:
    if kept.firsts and not any(kept.firsts):
        return "On another processor its shares repeat within their intervals, its digits do not."
    return f"The first flight of each cell: {kept.firsts_flown}." if kept.firsts_flown else ""


def _made(kept: Kept) -> str:
    commit = f", commit {kept.commit[:10]}" if kept.commit else ", of changed code"
    seed = "" if kept.seed is None else f", seed {kept.seed}"
    return f"{kept.created[:10]}{commit}{seed}"


def table(kept: Kept) -> list[list[str]]:
    """Return the table of a sweep, headings first: one quantity a column, without those that no row has."""
    axes = sorted(kept.axes, key=lambda axis: axis.name == kept.panels)
    found = {tuple(row[axis.name] for axis in axes): row for row in kept.table()}
    shown = [levels for levels in itertools.product(*(axis.levels for axis in axes)) if levels in found]
    columns = {heading: [of(found[levels]) for levels in shown] for heading, of in _quantities(kept).items()}
    held = {heading: cells for heading, cells in columns.items() if any(cells)}
    labels = [_labels(axes, levels, before) for before, levels in zip([(), *shown], shown, strict=False)]
    rows = [[*label, *cells] for label, *cells in zip(labels, *held.values(), strict=True)]
    return [[*(axis.label for axis in axes), *held], *rows]


def _labels(axes: Sequence[Axis], levels: Sequence[Any], before: Sequence[Any]) -> list[str]:
    """Return the levels of a row, without those that repeat the row before."""
    same = 0
    while same < len(axes) - 1 and [*levels[: same + 1]] == [*before[: same + 1]]:
        same += 1
    return [""] * same + [axis.show(level) for axis, level in zip(axes[same:], levels[same:], strict=True)]


SHARE = "share [%]"
EXPLAINED = {
    SHARE: "Share: of flights that completed or landed, with its Wilson 95 % interval.",
    "rotation error [°]": "Errors: the greatest of a flight that completed or landed; median, and at most.",
    "found after [s]": "Found after: median time since the failure, where half of the flights find one.",
    "announced before [s]": "Announced before: median time from the first mode to the loss.",
    "modes": "Modes: those of at least half of the flights.",
}
Quantity = Callable[[Mapping[str, Any]], str]
COUNTS: dict[str, Quantity] = {
    "flights": lambda row: str(row["flights"] or ""),
    "completed": lambda row: str(row["completed"]),
    "landed": lambda row: str(row["landed"] or ""),
    "landing": lambda row: str(row["landing"] or ""),
    "off course": lambda row: str(row["off_course"] or ""),
    "crashed": lambda row: str(row["crashed"] or ""),
    "fell": lambda row: str(row["lost"] - sum(row[end] for end in ("landing", "off_course", "crashed")) or ""),
}
SHOWN: dict[str, dict[str, Quantity]] = {
    "share": {SHARE: lambda row: _share(row)},
    "errors": {
        "rotation error [°]": lambda row: _number(row["rotation_deg_median"]),
        "at most [°]": lambda row: _number(row["rotation_deg_worst"]),
        "position error [cm]": lambda row: _number(row["com_cm_median"]),
        "at most [cm]": lambda row: _number(row["com_cm_worst"]),
    },
    "found": {"found after [s]": lambda row: _number(row["found_s"]) if 2 * row["degraded"] >= row["flights"] else ""},
    "announced": {"announced before [s]": lambda row: _number(row["announced_s"])},
    "modes": {"modes": lambda row: " ".join(f"`{name}`" for name, bit in MODES.items() if row["modes"] & bit)},
}
"""Quantities by their headings, those of every table and others."""


def _quantities(kept: Kept) -> dict[str, Quantity]:
    """Return what a table shows of a row, by heading."""
    return COUNTS | {name: of for shown, own in SHOWN.items() if shown in kept.shows for name, of in own.items()}


def _share(row: Mapping[str, Any]) -> str:
    done, flights = row["completed"] + row["landed"], row["flights"]
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


def _summary(summary: Any) -> Iterator[str | list[Sequence[str]]]:
    """Yield a text as it is, and figures as tables: one of plain ones, one for cases with the same figures."""
    if isinstance(summary, str):
        yield summary
        return
    cases = cases_of(summary)
    if plain := cases.pop(""):
        yield [("figure", "value"), *((key, _plain(value)) for key, value in plain.items())]
    by_figures: dict[tuple[str, ...], list[str]] = {}
    for case, figures in cases.items():
        by_figures.setdefault(tuple(figures), []).append(case)
    for columns, names in by_figures.items():
        yield [("case", *columns), *((case, *map(_plain, cases[case].values())) for case in names)]


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


def _plain(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
