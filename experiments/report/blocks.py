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
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from experiments import Refused, schema, studies
from experiments.report import command, kept, kept_tables, paper
from experiments.report.kept_tables import Names, Rows, Value, by_heading, of_columns, one
from experiments.report.page import table
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.quantities import shown
from jax_aero.base.result import ending

BLOCK = re.compile(r"^<!-- table\n(?P<asks>.*?)^-->\n.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)


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


def files() -> dict[Path, str]:
    """Return every page that has a block, as it should be."""
    texts = {path: path.read_text(encoding="utf-8") for path in pages()}
    return {path: written(text, path) for path, text in texts.items() if BLOCK.search(text)}


def pages() -> list[Path]:
    """Return the pages that are written by hand."""
    own = [places.HOME / "README.md", places.HOME / "CONTRIBUTING.md"]
    return [*own, *sorted((places.HOME / "docs").rglob("*.md")), *sorted(studies.FOLDER.glob("*/README.md"))]


def written(text: str, path: Path) -> str:
    """Return a page with its tables."""

    def write(block: re.Match[str]) -> str:
        line = text.count("\n", 0, block.start()) + 1
        try:
            asked = msgspec.convert(tomllib.loads(block["asks"]), Asked)
            return f"<!-- table\n{block['asks']}-->\n{shows(asked)}\n<!-- end -->"
        except (msgspec.ValidationError, ValueError) as reason:
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


def _of_kept(asked: Asked) -> Rows:
    document = kept.read(asked.kept)
    if not document.rows:
        return kept_tables.of_study(document, asked.columns, asked.rows, asked.digits)
    if not isinstance(asked.rows, dict):
        axes = ", ".join(axis.name for axis in document.axes)
        raise Refused(f"rows is {asked.rows}; expected levels by axis: {axes}")
    return kept_tables.of_sweep(document, asked.columns, asked.rows, asked.across, asked.digits)


def _of_claims(asked: Asked) -> Rows:
    found, claims = command.documented(), paper.all_claims()
    rows = []
    for text, key in by_heading(asked.claims).items():
        states, finding = one(claims, key, "claim").states, one(found, key, "finding of the claim")
        said = {"claim": states if text == key else text, "measured": finding.measured, "verdict": str(finding.verdict)}
        rows.append({name: Value(cell) for name, cell in said.items()})
    return of_columns(asked.columns or ["claim", "verdict"], rows, {}, asked.digits)


def _of_flights(asked: Asked) -> Rows:
    rows = []
    for name in by_heading(asked.flights).values():
        one(dict.fromkeys(places.names("experiments")), name, "experiment")
        config, flight = _flown(name)
        row = {"title": Value(config["title"]), "lost_time": Value(flight.lost_time, "s")}
        row["outcome"] = Value(ending(flight.outcome, flight.lost_time, flight.lost_reason))
        for figure, declared in rust.figures().items():
            number = shown(declared, flight.summary.get(figure, math.nan))
            row[figure] = Value(number.values, number.unit.replace("deg", "°"))
        rows.append(row)
    labels = {name: figure.label for name, figure in rust.figures().items()} | {"lost_time": "lost at"}
    headings, cells = of_columns(asked.columns, rows, labels, asked.digits)
    texts = [f"`{name}`" if text == name else text for text, name in by_heading(asked.flights).items()]
    return ["flight", *headings], [[text, *row] for text, row in zip(texts, cells, strict=True)]


@cache
def _flown(name: str) -> tuple[Mapping[str, Any], rust.FlightResult]:
    config = rust.load_config(name)
    return config, rust.fly(config)


def _of_config(asked: Asked) -> Rows:
    folder, _, name = asked.config.partition("/")
    node = one(rust.schemas(), folder, "folder of configs with keys")
    table = rust.read_table(places.find(folder, name), node, {})
    keys = by_heading(asked.rows)
    rows = []
    for text, key in keys.items():
        value: Any = table
        for part in key.split("."):
            value = one(value if isinstance(value, Mapping) else {}, part, "key")
        meaning, unit = schema.described(node, key)
        cells = {"key": f"`{key}`" if text == key else text, "value": f"{_plain(value)} {unit}".rstrip()}
        rows.append({column: Value(cell) for column, cell in (cells | {"meaning": meaning}).items()})
    return of_columns(asked.columns or ["key", "value"], rows, {}, asked.digits)


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return f"({', '.join(map(_plain, value))})"
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{value:g}".replace("-", "−") if is_number else str(value)
