"""Tables of pages, written from what they show: kept results and flights.

A page has a block between two comments, the first of which is TOML:

```text
<!-- table
kept = "robot_missions"
columns = ["completed", "rotation_error_deg_worst_of_all"]
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

from experiments.report.page import table
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.controllers import CONTROLLERS
from jax_aero.base.quantities import shown
from jax_aero.base.result import ending
from jax_aero.base.terminal import Refused
from jax_aero.base.typed_config import scenario_config
from jax_aero.commands import study as studies
from jax_aero.refusals import refused
from jax_aero.stored import kept
from jax_aero.stored.kept import Names, Rows, Value, by_heading, one, table_of
from jax_aero.verify import compared

BLOCK = re.compile(r"^<!-- table\n(?P<asks>.*?)^-->\n.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)


class Asked(msgspec.Struct, forbid_unknown_fields=True):
    """What a block shows: one of `kept`, `flights`, `controllers` and `compared`."""

    kept: str | dict[str, str] = ""
    """A kept result, or several by the heading of their row."""
    flights: Names = []
    """Experiments, which are flown; `{baseline}` in a heading is the label of this controller."""
    controllers: bool = False
    """The controllers with their labels."""
    compared: bool = False
    """What of each shipped experiment `jax-aero verify` compares, and the keys that JAX refuses."""
    rows: Any = {}
    """Of a sweep: levels by axis, all of an axis that is left out; of a study: cases."""
    across: str = ""
    """Axis of a sweep whose levels are columns, of one quantity."""
    columns: Names = []


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
    sources = {"kept": _of_kept, "flights": _of_flights, "controllers": _of_controllers, "compared": _of_compared}
    named = [source for source in sources if getattr(asked, source)]
    if len(named) != 1:
        raise Refused(f"a table shows {' and '.join(named) or 'nothing'}; expected one of {', '.join(sources)}")
    headings, rows = sources[named[0]](asked)
    return table(rows, *headings)


def _of_kept(asked: Asked) -> Rows:
    if isinstance(asked.kept, dict):
        tables = {text: _of_kept(msgspec.structs.replace(asked, kept=name)) for text, name in asked.kept.items()}
        rows = [[text, *row[1:]] for text, (_, rows) in tables.items() for row in rows]
        return next(headings for headings, _ in tables.values()), rows
    document = kept.read(asked.kept)
    if not document.rows:
        return kept.study_table(document, asked.columns, asked.rows)
    if not isinstance(asked.rows, dict):
        axes = ", ".join(axis.name for axis in document.axes)
        raise Refused(f"rows is {asked.rows}; expected levels by axis: {axes}")
    return kept.sweep_table(document, asked.columns, asked.rows, asked.across)


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
    headings, cells = table_of(asked.columns, rows, labels)
    named = {key: controller.label for key, controller in CONTROLLERS.items()}
    texts = [
        f"`{name}`" if text == name else text.format_map(named) for text, name in by_heading(asked.flights).items()
    ]
    return ["flight", *headings], [[text, *row] for text, row in zip(texts, cells, strict=True)]


def _of_controllers(_: Asked) -> Rows:
    rows = [[named.label, f"`{name}`", *named[1:]] for name, named in CONTROLLERS.items()]
    return ["controller", "`configs/control/`", "has", "needs", "use it for"], rows


def _of_compared(_: Asked) -> Rows:
    words = {"tick": "every tick, and the flight from its start", "law": "the law alone", "nothing": "nothing"}
    flights: dict[tuple[str, ...], list[str]] = {}
    for name in places.names("experiments"):
        config = rust.load_config(name)
        lacks = refused(scenario_config(config))
        parts = ({f"`{refusal.key}`" for refusal in lacks}, {refusal.lacks for refusal in lacks})
        flights.setdefault((words[compared(config)], *(", ".join(sorted(part)) for part in parts)), []).append(name)
    whole = flights.pop((words["tick"], "", ""))
    rows = [[", ".join(f"`{name}`" for name in names), *how] for how, names in sorted(flights.items())]
    return ["experiments", "compared", "JAX refuses", "as it lacks"], [
        *rows,
        [f"the {len(whole)} others", words["tick"], "", ""],
    ]


@cache
def _flown(name: str) -> tuple[Mapping[str, Any], rust.FlightResult]:
    config = rust.load_config(name)
    return config, rust.fly(config)
