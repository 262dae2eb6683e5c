"""Ties of the numbers in prose to results: `python -m docs.ties` names every number that is not what its cell holds.

A comment after a sentence, list or table, `<!-- from: CELL; CELL -->`, names a cell for each number with a unit, and
for each count such as 7 of 8, since the comment before, in their order. A cell is

* `NAME[LEVEL|LEVEL] COLUMN`: of a kept result (`docs/results/`), in the row of these levels; a level of several axes
  is `AXIS=LEVEL`, and axes that are left out range over all levels. If rows differ, `sum`, `least` or `greatest`
  follows. A count stands beside its flights. A column that is an axis, or `title`, is a text. `[LEVEL] COLUMN` is of
  the result of the cell before, for axes that it leaves out in the row of that cell;
* `NAME[FIGURE]`: a figure of a study; `flight[EXPERIMENT] FIGURE`: of a flight, which is flown;
* `claims[KEY]`, `NAME[KEY]`: a text, what a claim has measured; `FILE`: a text, a file of the repository;
* of a text, the number at `#` in `"words # words"`, whose places have to agree, quotation marks left out and
  `…` for anything on the way; `in UNIT` follows if the text does not say its unit and it is not that of the SI.

The number has to be that of the cell, rounded as it is shown; `--write` makes it so. `paper` and `arXiv:NUMBER` stand
for what others have published, `commit:HASH` for what the code of a commit has measured; neither is checked. Code,
formulas, headings and links are left out.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from experiments.report import judge, kept
from jax_aero import rust
from jax_aero.base import places

ROOT = Path(__file__).resolve().parents[1]

PAGES: tuple[str, ...] = ()
"""Pages whose numbers are tied, in `docs/`."""

UNITS: Mapping[str, tuple[str, float]] = {
    "°": ("rad", math.radians(1.0)), "rad": ("rad", 1.0), "deg": ("rad", math.radians(1.0)),
    "%": ("", 0.01), "percentage points": ("", 0.01),
    "km": ("m", 1e3), "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "µm": ("m", 1e-6),
    "h": ("s", 3600.0), "min": ("s", 60.0), "s": ("s", 1.0), "ms": ("s", 1e-3), "µs": ("s", 1e-6), "ns": ("s", 1e-9),
    "kHz": ("1/s", 1e3), "Hz": ("1/s", 1.0), "1/s": ("1/s", 1.0), "1/s²": ("1/s²", 1.0),
    "m/s": ("m/s", 1.0), "m/s²": ("m/s²", 1.0), "rad/s": ("rad/s", 1.0), "°/s": ("rad/s", math.radians(1.0)),
    "N": ("N", 1.0), "N/s": ("N/s", 1.0), "N m": ("N m", 1.0), "N m/s": ("N m/s", 1.0), "N m s": ("N m s", 1.0),
    "N m/rad": ("N m/rad", 1.0), "mm/N": ("m/N", 1e-3), "m/N": ("m/N", 1.0),
    "kg": ("kg", 1.0), "kg m²": ("kg m²", 1.0), "l": ("l", 1.0), "l/min": ("l/min", 1.0),
    "m²": ("m²", 1.0), "m³": ("m³", 1.0), "m⁴": ("m⁴", 1.0), "kB": ("B", 1e3), "MB": ("B", 1e6), "GB": ("B", 1e9),
}  # fmt: skip
"""Units: the unit that they are compared in, and the factor."""

NUMBER = r"[+−-]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?:e[−-]?\d+)?"
UNIT = "|".join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True))
BETWEEN = r"(?:,?\s+(?:to|and|or)\s+|,\s+|;\s+|\s+\(|\)\s+to\s+)\(?"
"""Between numbers that share a unit."""
QUANTITY = re.compile(
    rf"(?<![\w.\-−/^])(?P<numbers>{NUMBER}(?:{BETWEEN}{NUMBER}\)?)*)\)?\s*(?P<unit>{UNIT})(?![\w/²³⁴^])"
)
WHOLE = r"\d+(?:,\d{3})*"
COUNT = re.compile(rf"(?<![\w.])(?P<part>{WHOLE}|[Nn]one|[Aa]ll)\s+of\s+(?P<whole>{WHOLE})(?![\w%°]|\.\d)")
TIE = re.compile(r"<!-- from: (?P<cells>.+?) -->", re.DOTALL)
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
LEFT_OUT = re.compile(
    r"^```.*?^```$ | <!--.*?--> | ^\#.*?$ | `[^`\n]+` | \$[^$\n]+\$ | (?<=\])\([^)]*\) | ^\ *!\[[^\]]*\]",
    re.MULTILINE | re.DOTALL | re.VERBOSE,
)
BETWEEN_CELLS = re.compile(r""";(?=(?:[^"]*"[^"]*")*[^"]*$)""")
"""Not within quotes."""
AFTER = "||"
"""Between keys of the cell before and those of a cell, which replace them."""
PUBLISHED = re.compile(r"paper|arXiv:\S+|commit:[0-9a-f]{8}")
CELL = re.compile(
    rf"""(?P<source>[\w./-]+)  (?:\[(?P<keys>.+?)\](?=\ |$))?
    (?:\ (?P<column>\w+))??  (?:\ (?P<over>sum|least|greatest))?
    (?:\ "(?P<text>[^"]+)")?  (?:\ in\ (?P<unit>{UNIT}))?""",
    re.VERBOSE,
)
COLUMN_UNITS = {"deg": "°", "cm": "cm", "s": "s"}


class Wrong(ValueError):
    """A cell is not there, or not one."""


class Shown(NamedTuple):
    """A number that a page shows, or a count such as 7 of 8, and where."""

    start: int
    text: str
    unit: str
    """Empty for a count."""

    @property
    def end(self) -> int:
        """Return the end of its place."""
        return self.start + len(self.text)

    def as_of(self, value: Value) -> str:
        """Return how a value would be written in its place."""
        if not self.unit:
            if value.flights is None:
                raise Wrong("is no count")
            part, whole = value.flights
            count = COUNT.fullmatch(self.text)
            assert count is not None
            is_word = {"none": 0, "all": whole}.get(count["part"].lower()) == part
            between = self.text[count.end("part") : count.start("whole")]
            comma = "," if "," in self.text else ""
            return f"{count['part'] if is_word else f'{part:{comma}}'}{between}{whole:{comma}}"
        unit, factor = UNITS[self.unit]
        if value.unit not in (unit, None):
            raise Wrong(f"has the unit {value.unit or 'of a ratio'}")
        mantissa, e, exponent = self.text.replace("−", "-").partition("e")
        decimals = len(mantissa.partition(".")[2])
        number = value.number / factor / 10.0 ** int(exponent or 0)
        sign = "" if self.text[0].isdecimal() else "+" if number >= 0 else self.text[0].replace("+", "−")
        comma = "," if "," in mantissa else ""
        return f"{sign}{abs(number):{comma}.{decimals}f}{e}{self.text.partition('e')[2]}"


class Value(NamedTuple):
    """What a cell holds."""

    number: float
    unit: str | None
    """As units are compared; `None` if the source does not say it, then that of the SI."""
    flights: tuple[int, int] | None = None
    """Flights that a count counts, and all."""


def main() -> int:
    """Print every number that is wrong, or write it; return whether there is one."""
    parser = argparse.ArgumentParser("python -m docs.ties", description="Compare numbers in prose with their cells.")
    parser.add_argument("pages", nargs="*", type=Path, default=[ROOT / "docs" / page for page in PAGES])
    parser.add_argument("--write", action="store_true", help="write what the cells hold")
    given = parser.parse_args()
    found = []
    for path in given.pages:
        page = path.read_text(encoding="utf-8")
        if given.write:
            path.write_text(page := written(page), encoding="utf-8")
        found += [f"{path}: {text}" for text in loose(page)]
    print("\n".join(found))
    return 1 if found else 0


def loose(page: str) -> Iterator[str]:
    """Yield what is wrong with the numbers of a page: line, number, and why."""
    for shown, cell in ties(page):
        at = f"line {page.count(chr(10), 0, shown.start) + 1}: {' '.join(f'{shown.text} {shown.unit}'.split())}"
        if not cell:
            yield f"{at} has no cell"
        elif not shown.text:
            yield f"{at}`{cell}` is a cell without a number"
        elif not PUBLISHED.fullmatch(cell):
            try:
                expected = shown.as_of(value(cell))
            except Wrong as reason:
                yield f"{at}: `{cell}` {reason}"
            else:
                if expected != shown.text:
                    yield f"{at} is {expected} in `{cell}`"


def written(page: str) -> str:
    """Return a page with the numbers that the cells hold."""
    for shown, cell in reversed(list(ties(page))):
        if cell and shown.text and not PUBLISHED.fullmatch(cell):
            page = page[: shown.start] + shown.as_of(value(cell)) + page[shown.end :]
    return page


def mutations(page: str) -> Iterator[str]:
    """Yield a page with each of its tied numbers wrong: in its last digit, a count by one."""
    for shown, cell in ties(page):
        if PUBLISHED.fullmatch(cell):
            continue
        digits = list(re.finditer(r"\d+", shown.text.partition("e")[0] if shown.unit else shown.text))
        for found in digits[-1:] if shown.unit else digits:
            for by in (1, -1):
                other = f"{abs(int(found[0]) + by):0{len(found[0])}d}"
                start = shown.start + found.start()
                yield page[:start] + other + page[start + len(found[0]) :]


def ties(page: str) -> Iterator[tuple[Shown, str]]:
    """Yield every number of a page with its cell; either is empty without the other."""
    text = LEFT_OUT.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), page)
    numbers = sorted([*counts(text), *quantities(text), *in_columns(text)])
    begin = 0
    for tie in [*TIE.finditer(page), None]:
        end = tie.start() if tie else len(page)
        cells = list(whole(tie["cells"])) if tie else []
        mine = [shown for shown in numbers if begin <= shown.start < end]
        for place in range(max(len(mine), len(cells))):
            shown = mine[place] if place < len(mine) else Shown(end, "", "")
            yield shown, cells[place] if place < len(cells) else ""
        begin = end


def whole(cells: str) -> Iterator[str]:
    """Yield the cells of a comment, each with the source, and the keys, that it takes from the cell before."""
    source = keys = ""
    for cell in (" ".join(cell.split()) for cell in BETWEEN_CELLS.split(cells)):
        named, own, rest = re.fullmatch(r"([^\s\[\"]*)(?:\[(.*?)\](?= |$))?(.*)", cell).groups("")  # type: ignore[union-attr]
        source, keys = (named, "") if named else (source, keys)
        keys = AFTER.join(filter(None, (keys, own)))
        yield " ".join(filter(None, (f"{source}[{keys}]" if keys else source, rest.strip())))


def counts(text: str) -> Iterator[Shown]:
    """Yield every count of some among others."""
    for found in COUNT.finditer(text):
        yield Shown(found.start(), found[0], "")


def quantities(text: str) -> Iterator[Shown]:
    """Yield every number with a unit, also those that share one: 1.0, 2.0 and 3.0 m."""
    for found in QUANTITY.finditer(COUNT.sub(lambda count: " " * len(count[0]), text)):
        for number in re.finditer(NUMBER, found["numbers"]):
            yield Shown(found.start() + number.start(), number[0], found["unit"])


def in_columns(text: str) -> Iterator[Shown]:
    """Yield the numbers of tables that have their unit from the heading, `drag [m²]`."""
    for table in TABLE.finditer(text):
        headings = table[0].partition("\n")[0].split("|")
        units = [found[1] if (found := re.search(r"\[(.+?)\]", heading)) else "" for heading in headings]
        for line in list(re.finditer(r".+", table[0]))[2:]:
            cells = list(re.finditer(r"[^|]+(?=\|)", line[0]))
            for cell, unit in zip(cells, units[1:], strict=False):
                number = re.search(NUMBER, cell[0])
                if unit in UNITS and number and not QUANTITY.search(cell[0]):
                    yield Shown(table.start() + line.start() + cell.start() + number.start(), number[0], unit)


# --- cells -----------------------------------------------------------------------------------------------------------


@cache
def value(cell: str) -> Value:
    """Return what a cell holds."""
    words = CELL.fullmatch(cell)
    if words is None:
        raise Wrong("is no cell")
    if words["source"] == "flight":
        found = _of_flight(_last(words["keys"]), words["column"] or "")
    elif (kept.FOLDER / f"{words['source']}.json").is_file():
        found = _of_kept(kept.read(words["source"]), words)
    else:
        found = _of_text(_text(words), words)
    unit = words["unit"]
    return found if unit is None else Value(found.number * UNITS[unit][1], UNITS[unit][0])


def _text(words: re.Match[str]) -> str:
    if words["source"] == "claims":
        claims = judge.read(ROOT / "docs/claims.json")
        if (key := _last(words["keys"])) not in claims:
            raise Wrong("names no claim")
        return claims[key].measured
    path = ROOT / words["source"]
    if not path.is_file():
        raise Wrong("names no kept result and no file")
    return path.read_text(encoding="utf-8").replace('"', "")


def _last(keys: str | None) -> str:
    return (keys or "").rpartition(AFTER)[2]


def _of_text(text: str, words: re.Match[str]) -> Value:
    before, hash_, after = (words["text"] or "#").partition("#")
    if not hash_:
        raise Wrong("has no #")
    around = [r"\s+".join(map(re.escape, re.split(r"\s+", part))).replace("…", ".*?") for part in (before, after)]
    unit = rf"(?: of (?P<whole>{WHOLE}))?(?=(?:[ \u00a0]?(?P<unit>{UNIT})(?![\w/²³⁴^]))?)"
    places = re.finditer(rf"{around[0]}(?<![\d.])(?P<number>{NUMBER}){unit}{around[1]}", text, re.DOTALL)
    found = {place.group("number", "whole", "unit") for place in places}
    if len(found) != 1:
        raise Wrong(f"holds {', '.join(' '.join(filter(None, one)) for one in found) or 'nothing'}")
    ((text_, of, name),) = found
    number = float(text_.replace(",", "").replace("−", "-"))
    if of is not None:
        return Value(number, "", (int(number), int(of.replace(",", ""))))
    return Value(number, None) if name is None else Value(number * UNITS[name][1], UNITS[name][0])


def _of_flight(name: str, figure: str) -> Value:
    """Return a figure of an experiment's summary, or `lost_time`."""
    if name not in places.names("experiments"):
        raise Wrong("names no experiment")
    flight = _flown(name)
    number = flight.lost_time if figure == "lost_time" else flight.summary.get(figure)
    if number is None:
        raise Wrong("names no figure")
    unit = "s" if figure == "lost_time" else rust.figures()[figure].unit.replace(" s-1", "/s")
    return Value(number, UNITS[unit][0] if unit in UNITS else "")


@cache
def _flown(name: str) -> rust.FlightResult:
    return rust.fly(rust.load_config(name))


def _of_kept(result: kept.Kept, words: re.Match[str]) -> Value:
    key, column = _last(words["keys"]), words["column"]
    if column == "title":
        return _of_text(f"{result.title}. {result.about}", words)
    if key in result.claims:
        return _of_text(f"{result.states[key]}: {result.claims[key].measured}", words)
    if isinstance(result.summary, Mapping) and column is None:
        return _of_summary(result.summary, key)
    rows = _rows(result, (words["keys"] or "").replace(AFTER, "|"))
    if column in {axis.name for axis in result.axes}:
        return _of_text("\n".join({str(row[column]) for row in rows}), words)
    if column not in result.columns or not rows:
        raise Wrong(f"names no {'row' if column in result.columns else 'column'}")
    held = [row[column] for row in rows]
    flights = [row["flights"] for row in rows]
    if words["over"] is None and (len(set(held)) > 1 or len(set(flights)) > 1):
        raise Wrong(f"holds {', '.join(map(str, sorted(set(held))))}")
    number, of = (sum(held), sum(flights)) if words["over"] == "sum" else _extreme(words["over"], held, flights)
    unit, factor = next((UNITS[COLUMN_UNITS[part]] for part in column.split("_")[1:] if part in COLUMN_UNITS), ("", 1))
    return Value(number * factor, unit, (number, of))


def _extreme(over: str | None, held: list[Any], flights: list[int]) -> tuple[Any, int]:
    return (max if over == "greatest" else min)(zip(held, flights, strict=True))


def _rows(result: kept.Kept, keys: str) -> list[dict[str, Any]]:
    """Return the rows of these levels, of each of the others for axes that are left out."""
    chosen: dict[str, str] = {}
    for key in keys.split("|") if keys else ():
        name, is_named, level = key.partition("=")
        axes = [name] if is_named else [axis.name for axis in result.axes if key in map(axis.show, axis.levels)]
        if len(axes) != 1:
            raise Wrong(f"has the level {key} of {len(axes)} axes")
        chosen[axes[0]] = level if is_named else key
    return [
        row
        for row in result.table()
        if all(
            axis.show(row[axis.name]) == chosen[axis.name] if axis.name in chosen else row[axis.name] != kept.ALL
            for axis in result.axes
        )
    ]


def _of_summary(summary: Mapping[str, Any], key: str) -> Value:
    """Return a figure of a study, whose name may end in a unit: `drag [m2]`."""
    number: Any = summary
    for part in key.split("|"):
        number = number.get(part) if isinstance(number, Mapping) else None
    if not isinstance(number, int | float):
        raise Wrong("names no figure")
    bracket = re.search(r"\[(.+?)\]", key)
    unit = re.sub(r"(?<=m)([234])", lambda found: "⁰¹²³⁴"[int(found[1])], bracket[1]) if bracket else ""
    return Value(number * UNITS[unit][1], UNITS[unit][0]) if unit in UNITS else Value(float(number), None)


if __name__ == "__main__":
    raise SystemExit(main())
