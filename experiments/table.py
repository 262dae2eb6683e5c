"""Text tables: of any cells, and of the outcomes of flights, from their manifests."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from jax_aero.base.result import ending
from jax_aero.rust import SETTLING_TIME

HEADINGS = (
    "flight",
    "outcome",
    f"max CoM error from {SETTLING_TIME:g} s [m]",
    "max rotation error [deg]",
    "thrusts [N]",
)


def outcome_table(manifests: Iterable[Mapping[str, Any]]) -> str:
    """Return one line per flight: outcome, time and reason of a loss, largest errors, thrust range."""
    return text_table([HEADINGS, *(_row(manifest) for manifest in manifests)])


def text_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows in columns of equal width; the first row is the heading. A text of several lines is one line."""
    rows = [[cell.replace("\n", "\\n") for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def csv_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as comma-separated values."""
    written = io.StringIO()
    csv.writer(written, lineterminator="\n").writerows(rows)
    return written.getvalue().rstrip("\n")


def latex_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as a `tabular` with the rules of booktabs; `$...$` is mathematics."""
    head, *body = [" & ".join(map(_latex, row)) + r" \\" for row in rows]
    columns = "l" * len(rows[0])
    return "\n".join(
        [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"]
    )


def _latex(text: str) -> str:
    parts = re.split(r"(\$[^$]*\$)", text)
    plain = (re.sub(r"[\\&%#_{}~^$]", lambda found: LATEX.get(found[0], rf"\{found[0]}"), part) for part in parts[::2])
    words = [part.replace("°", r"\textdegree{}").replace("−", r"\textminus{}") for part in plain]
    return "".join(one for pair in itertools.zip_longest(words, parts[1::2], fillvalue="") for one in pair)


LATEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
FORMATS: Mapping[str, Callable[[Sequence[Sequence[str]]], str]] = {
    "text": text_table,
    "csv": csv_table,
    "latex": latex_table,
}
"""Formats of a printed table, as `--table` names them."""


def _row(manifest: Mapping[str, Any]) -> Sequence[str]:
    summary = manifest["summary"]
    rotation = summary.get("max_rotation_error")
    outcome = ending(manifest["outcome"], manifest["lost_time"], manifest["lost_reason"])
    if manifest["outcome"] == "descended":
        outcome += f", arrives at {_number(summary.get('end_speed'), '.1f')} m/s"
    return (
        manifest["name"],
        outcome,
        _number(summary.get("max_com_error"), ".3f"),
        _number(None if rotation is None else math.degrees(rotation), ".1f"),
        f"{_number(summary.get('thrust_min'), '.1f')} to {_number(summary.get('thrust_max'), '.1f')}",
    )


def _number(value: float | None, form: str) -> str:
    return "?" if value is None else format(value, form)
