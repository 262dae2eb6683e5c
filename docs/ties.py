"""Ties of the numbers in prose to results: `python -m docs.ties` names every number that is not tied, or is wrong.

A paragraph, list or table of a page of results that has a number with a unit, or a count such as 7 of 8, says where
they are from: `<!-- from: NAME ... -->`, within it or right after it. A NAME is a kept result (`docs/results/`),
`claims` (`docs/claims.json`), or a file of the repository; `paper` and `arXiv:...` stand for what others have
published, which is not checked. Each number has to occur there, to the rounding that is shown, in whatever unit. Code,
formulas, headings and links are left out.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from experiments.report import kept
from experiments.sweep.table import wilson

ROOT = Path(__file__).resolve().parents[1]

PAGES: tuple[str, ...] = (
    "failures.md",
    "observer.md",
    "ahead.md",
    "mk3.md",
    "ground.md",
    "moments.md",
    "cfd.md",
    "training.md",
    "deviations.md",
    "robot.md",
)
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
BETWEEN = r"(?:,? (?:to|and|or) |, |; | \(|\) to )\(?"
"""Between numbers that share a unit."""
QUANTITY = re.compile(
    rf"(?<![\w.\-−/^])(?P<numbers>{NUMBER}(?:{BETWEEN}{NUMBER}\)?)*)\)?[ \u00a0]?(?P<unit>{UNIT})(?![\w/²³⁴^])"
)
WHOLE = r"\d+(?:,\d{3})*"
COUNT = re.compile(rf"(?<![\w.])(?P<part>{WHOLE}|[Nn]one|[Aa]ll) of (?:the |these )?(?P<whole>{WHOLE})(?![\w.%°])")
TIE = re.compile(r"<!-- from: (?P<names>.+?) -->")
LEFT_OUT = re.compile(
    r"^```.*?^```$ | <!--(?!\ from:).*?--> | ^\#.*?$ | `[^`\n]+` | \$[^$\n]+\$ | (?<=\])\([^)]*\) | ^\ *!\[[^\]]*\]",
    re.MULTILINE | re.DOTALL | re.VERBOSE,
)
PUBLISHED = re.compile(r"paper|arXiv:\S+")


class Number(NamedTuple):
    """A number that a page shows."""

    text: str
    value: float
    half: float
    """Half of the last digit."""
    unit: str

    def is_among(self, known: Known) -> bool:
        """Return whether it is one of the numbers of a source, rounded."""
        unit, factor = UNITS[self.unit]
        value, half = factor * self.value, factor * self.half * (1.0 + 1e-9)
        without_unit = [scale * other for other in known.plain for scale in (1.0, factor)]
        return any(abs(abs(other) - abs(value)) <= half for other in (*known.of.get(unit, ()), *without_unit))


class Known(NamedTuple):
    """The numbers of a source."""

    of: dict[str, list[float]]
    """By the unit that they are compared in."""
    plain: list[float]
    """Without a unit."""
    counts: set[tuple[int, int]]
    """Numbers of flights among others."""


def main() -> int:
    """Print every number that is not tied, or wrong; return whether there is one."""
    names = [Path(word) for word in sys.argv[1:]] or [ROOT / "docs" / page for page in PAGES]
    found = [f"{path}: {text}" for path in names for text in loose(path.read_text(encoding="utf-8"))]
    print("\n".join(found))
    return 1 if found else 0


def loose(page: str) -> Iterator[str]:
    """Yield what is wrong with the numbers of a page: line, number, and why."""
    for line, block, names in blocks(page):
        shown: list[Number | re.Match[str]] = [*quantities(block), *COUNT.finditer(block)]
        if shown and not names:
            first = shown[0]
            yield f"line {line}: {first.text if isinstance(first, Number) else first[0]} is not tied to a result"
        if not names or any(map(PUBLISHED.fullmatch, names)):
            continue
        known = [source(name) for name in names]
        for number in quantities(block):
            if not any(map(number.is_among, known)):
                yield f"line {line}: {number.text} is not in {', '.join(names)}"
        for count in COUNT.finditer(block):
            if not any(_pair(count) in one.counts for one in known):
                yield f"line {line}: {count[0]} is not in {', '.join(names)}"


def blocks(page: str) -> Iterator[tuple[int, str, list[str]]]:
    """Yield every block of a page: its line, its text without what is left out, and what it is tied to."""
    text = LEFT_OUT.sub(lambda found: "\n" * found[0].count("\n"), page)
    found: list[tuple[int, str, list[str]]] = []
    line = 1
    for part in re.split(r"(\n\s*\n)", text):
        names = [name for tie in TIE.finditer(part) for name in tie["names"].split()]
        prose = TIE.sub("", part)
        if names and not prose.strip() and found:
            at, before, earlier = found.pop()
            found.append((at, before, [*earlier, *names]))
        elif part.strip():
            found.append((line, " ".join(_with_units(prose).split()), names))
        line += part.count("\n")
    yield from found


def _with_units(block: str) -> str:
    """Return a table with the units of its headings, `drag [m²]`, behind the numbers that have none."""
    rows = [line.strip().strip("|").split("|") for line in block.strip().splitlines()]
    if not block.lstrip().startswith("|") or len(rows) < 3:
        return block
    units = [found[1] if (found := re.search(r"\[(.+?)\]", heading)) else "" for heading in rows[0]]
    for row in rows[2:]:
        for place, (cell, unit) in enumerate(zip(row, units, strict=False)):
            if unit in UNITS and re.search(r"\d", cell) and not QUANTITY.search(cell):
                row[place] = f"{cell.strip()} {unit}"
    return "\n".join(" | ".join(row) for row in rows)


def quantities(text: str) -> Iterator[Number]:
    """Yield every number with a unit, also those that share one: 1.0, 2.0 and 3.0 m."""
    for found in QUANTITY.finditer(COUNT.sub("", text)):
        for number in re.findall(NUMBER, found["numbers"]):
            yield read_number(number, found["unit"])


def read_number(text: str, unit: str) -> Number:
    """Return a number as it is written."""
    plain = text.replace(",", "").replace("−", "-")
    mantissa, _, exponent = plain.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return Number(f"{text} {unit}", float(plain), 0.5 * 10.0 ** (int(exponent or 0) - decimals), unit)


def _pair(count: re.Match[str]) -> tuple[int, int]:
    whole = int(count["whole"].replace(",", ""))
    part = {"none": 0, "all": whole}.get(count["part"].lower())
    return (int(count["part"].replace(",", "")) if part is None else part), whole


# --- sources ---------------------------------------------------------------------------------------------------------


@cache
def source(name: str) -> Known:
    """Return the numbers of a kept result or of a file."""
    known = Known({}, [], set())
    if (kept.FOLDER / f"{name}.json").is_file():
        _add_kept(known, kept.read(name))
    else:
        path = ROOT / ("docs/claims.json" if name == "claims" else name)
        if not path.is_file():
            raise ValueError(f"`from: {name}` is no kept result and no file")
        text = path.read_text(encoding="utf-8")
        _add_text(known, text)
        known.plain.extend(float(number.replace(",", "").replace("−", "-")) for number in re.findall(NUMBER, text))
    return known


COLUMN_UNITS = {"deg": "°", "cm": "cm", "s": "s"}
SHARES = ("completed", "descended", "on_course", "off_course", "lost", "unwarned", "degraded")


def _add_kept(known: Known, result: kept.Kept) -> None:
    for row in result.table():
        for column, value in row.items():
            unit = next((COLUMN_UNITS[part] for part in column.split("_")[1:] if part in COLUMN_UNITS), None)
            if unit and value is not None:
                _add(known, value, unit)
        flights = row["flights"]
        for column in row.keys() & SHARES:
            known.counts.update({(row[column], flights), (flights - row[column], flights)})
            for share in (row[column] / flights, *wilson(row[column], flights)):
                known.of.setdefault("", []).extend((share, 1.0 - share))
        known.counts.add((row["unwarned"], row["lost"]))
    for axis in result.axes:
        for level in axis.levels:
            if isinstance(level, int | float):
                _add(known, level, axis.unit) if axis.unit in UNITS else known.plain.append(level)
    _add_value(known, "", result.summary)
    labels = [str(level) for axis in result.axes for level in axis.levels]
    _add_text(known, " | ".join([result.title, result.about, *labels]))
    for key, finding in result.claims.items():
        _add_text(known, f"{result.states[key]} {finding.measured} {finding.verdict}")


def _add(known: Known, value: float, unit: str) -> None:
    to, factor = UNITS[unit]
    known.of.setdefault(to, []).append(factor * value)


def _add_text(known: Known, text: str) -> None:
    for number in quantities(text):
        _add(known, number.value, number.unit)
    known.counts.update(map(_pair, COUNT.finditer(text)))


def _add_value(known: Known, key: str, value: Any) -> None:
    """Add the figures of a study, whose keys may end in a unit: `drag [m2]`."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            _add_value(known, str(name), item)
            _add_text(known, str(name))
    elif isinstance(value, list):
        for item in value:
            _add_value(known, key, item)
    elif isinstance(value, str):
        _add_text(known, value)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        bracket = re.search(r"\[(.+?)\]", key)
        unit = re.sub(r"(?<=m)([234])", lambda found: "⁰¹²³⁴"[int(found[1])], bracket[1]) if bracket else ""
        _add(known, value, unit) if unit in UNITS else known.plain.append(float(value))


if __name__ == "__main__":
    raise SystemExit(main())
