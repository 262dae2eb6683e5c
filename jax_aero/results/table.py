"""Tables as text, Markdown, CSV and LaTeX, by pandas; and that of the outcomes of flights, from their manifests."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, TypeAlias

from tabulate import tabulate

from jax_aero import rust
from jax_aero.base.quantities import shown
from jax_aero.base.result import ending

if TYPE_CHECKING:
    import pandas as pd

Rows: TypeAlias = Sequence[Sequence[str]]
"""Cells; the first row is the heading."""

TABLED = {name: figure for name, figure in rust.figures().items() if figure.is_tabled}
"""Figures of merit in a table of flights."""

HEADINGS = ("flight", "outcome", *(shown(figure).text for figure in TABLED.values()))


def outcome_table(manifests: Iterable[Mapping[str, Any]]) -> str:
    """Return one line per flight: outcome, time and reason of a loss, and the figures of merit that tables show."""
    return text_table([HEADINGS, *(outcome_row(manifest) for manifest in manifests)])


def text_table(rows: Rows) -> str:
    """Return rows in columns of equal width, numbers below each other. A text of several lines is one line."""
    return _tabulate([[cell.replace("\n", "\\n") for cell in row] for row in rows], "simple")


def markdown_table(rows: Rows) -> str:
    """Return rows as a table of Markdown, not padded: one number that changes is one row that changes."""
    cells = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    head, *body = cells
    text: str = tabulate(body, head, tablefmt="github", disable_numparse=True)
    return re.sub(r"(?<= ) +|(?<=---)-+", "", text)


def csv_table(rows: Rows) -> str:
    """Return rows as comma-separated values."""
    text: str = _frame(rows).to_csv(index=False, lineterminator="\n")
    return text.rstrip("\n")


def latex_table(rows: Rows) -> str:
    """Return rows as a `tabular` with the rules of booktabs, at most 16 cm wide; `$...$` is mathematics.

    A heading has a line for each of its parts between commas, so that it is not wider than its numbers need.
    """
    (head, *body), sides = _align(rows, "\u2007")
    stacked = [_stack(heading, side) for heading, side in zip(head, sides, strict=True)]
    styled = _frame([stacked, *body]).style.hide(axis="index").format(escape="latex-math")
    styled = styled.format_index(escape="latex-math", axis="columns")
    text: str = styled.to_latex(hrules=True, column_format="".join(side[0] for side in sides))
    box = "\\begin{adjustbox}{max width=16cm}", "\\end{adjustbox}"
    return f"{box[0]}\n{text.rstrip().translate(SIGNS)}\n{box[1]}"


def _stack(heading: str, side: str) -> str:
    """Return a heading with its parts between commas one below the other, by characters of `STACKS`."""
    parts = COMMA.split(heading)
    return heading if len(parts) == 1 else STACKS[side] + f",{STACKS['line']}".join(parts) + STACKS["end"]


def _frame(rows: Rows) -> pd.DataFrame:
    import pandas as pd  # takes longer than a flight

    head, *body = rows
    return pd.DataFrame(body, columns=head, dtype=str)


def _align(rows: Rows, space: str) -> tuple[Rows, list[str]]:
    """Return rows whose intervals have equally wide numbers in a column, and the side of each column."""
    columns, sides = [], []
    for heading, *cells in zip(*rows, strict=True):
        is_of_numbers = any(cells) and all(INTERVAL.fullmatch(cell) or not cell for cell in cells)
        sides.append("right" if is_of_numbers else "left")
        if any("(" in cell for cell in cells) and is_of_numbers:
            widths = [max(map(len, ends)) for ends in zip_longest(*map(NUMBER.findall, cells), fillvalue="")]
            cells = [_pad(cell.replace("-", "−"), widths, space) for cell in cells]
        columns.append([heading, *cells])
    return list(zip(*columns, strict=True)), sides


def _pad(cell: str, widths: Iterable[int], space: str) -> str:
    left = iter(widths)
    return NUMBER.sub(lambda match: match[0].rjust(next(left), space), cell)


NUMBER = re.compile(r"[-+−]?(?:\d+(?:\.\d+)?|lost)")
INTERVAL = re.compile(rf"{NUMBER.pattern}(?: \({NUMBER.pattern} to {NUMBER.pattern}\))?")


def _tabulate(rows: Rows, form: str) -> str:
    aligned, sides = _align(rows, " ")
    head, *body = aligned
    text: str = tabulate(body, head, tablefmt=form, disable_numparse=True, colalign=sides)
    return "\n".join(line.rstrip() for line in text.splitlines())


COMMA = re.compile(r", (?=(?:[^$]*\$[^$]*\$)*[^$]*$)")
"""A comma outside of `$...$`."""

STACKS = {"left": "\ue000", "right": "\ue001", "line": "\ue002", "end": "\ue003"}
"""Characters of no text, which stand for parts of a `\\shortstack` until a table is escaped."""

SIGNS = str.maketrans(
    {sign: rf"\ensuremath{{{sign}}}" for sign in "<>|"}
    | {"±": r"\ensuremath{\pm}", "≤": r"\ensuremath{\leq}", "≥": r"\ensuremath{\geq}"}
    | {"−": r"\ensuremath{-}", "°": r"\ensuremath{^\circ}", "\u2007": r"\phantom{0}"}
    | {
        STACKS["left"]: r"\shortstack[l]{",
        STACKS["right"]: r"\shortstack[r]{",
        STACKS["line"]: r"\\",
        STACKS["end"]: "}",
    }
)
"""Signs that fonts of LaTeX lack, in text or in mathematics, and the characters of `STACKS`."""

FORMATS: Mapping[str, Callable[[Rows], str]] = {"text": text_table, "csv": csv_table, "latex": latex_table}
"""Formats of a printed table, as `--format` names them."""


def outcome_row(manifest: Mapping[str, Any]) -> Sequence[str]:
    """Return the cells of a flight, below `HEADINGS`."""
    summary = manifest["summary"]
    outcome = ending(manifest["outcome"], manifest["lost_time"], manifest["lost_reason"])
    if manifest["outcome"] == "landed":
        outcome += f", arrives at {_number(summary, 'end_speed')} m/s"
    return (manifest["name"], outcome, *(_number(summary, name) for name in TABLED))


def _number(summary: Mapping[str, float | None], name: str) -> str:
    value = summary.get(name)
    return "?" if value is None else f"{shown(rust.figures()[name], value).values:.1f}"
