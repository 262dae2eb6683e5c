"""Judgement of the claims that stand in the files of sweeps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from experiments.report.findings import Judged, judge
from experiments.report.results import Cell, Results, Sweep
from experiments.sweep.criteria import Criterion
from experiments.sweep.intervals import wilson
from jax_aero.base import places, tables

UNITS = {"rotation_error_deg": "°", "com_error": " m", "joint_error_sum_deg": "°"}
"""Units of quantities, as they follow a number."""


def of_sweep(name: str) -> tuple[Criterion, ...]:
    """Return the claims in the file of a shipped sweep, without reading what its levels name."""
    path = places.find("sweeps", name)
    found = tables.read(path).get("claim", [])
    return tables.convert({"claim": found}, _Claims, path.name).claim


class _Claims(tables.Table, frozen=True):
    claim: tuple[Criterion, ...] = ()


def decide(results: Results, *, name: str, claim: Criterion) -> Judged:
    """Return what a sweep has for its claim, and whether that holds."""
    sweep = results.sweep(name)
    return judge_cells([cell for cell in sweep.cells if claim.covers(cell)], _axes(sweep), claim)


def _axes(sweep: Sweep) -> list[str]:
    return [axis["name"] for axis in sweep.document["axes"]]


def judge_cells(cells: Sequence[Cell], axes: Sequence[str], claim: Criterion) -> Judged:
    """Return the figures of the cells that decide a claim, and the verdict, which names those in which it fails."""
    if not cells:
        raise LookupError(f"no cell of the claim `{claim.key}`")
    if claim.share is not None:
        part, whole = (
            sum(cell[key] for cell in cells for key in keys) for keys in ((claim.share.of,), claim.share.among)
        )
        text = f"{claim.share.of} {_count(part, whole)}"
        return text, judge(part <= claim.share.at_most * whole, text)
    varying = [axis for axis in axes if len({cell[axis] for cell in cells}) > 1]
    bad = [f"{_label(cell, varying)}: {how}" for cell in cells for how in _failures(cell, claim)]
    ended, flights = _sum(cells, claim.outcomes), _sum(cells, ["flights"])
    said = [f"{_count(ended, flights)} {' or '.join(claim.outcomes)}", *_ranges(cells, claim.at_most)]
    return "; ".join(said), judge(not bad, ", ".join(bad))


def _sum(cells: Iterable[Cell], columns: Iterable[str]) -> int:
    return sum(int(cell[column]) for cell in cells for column in columns)


def _count(part: int, whole: int) -> str:
    low, high = (100.0 * end for end in wilson(part, whole))
    return f"{part} of {whole} ({low:.1f} to {high:.1f} %)"


def _failures(cell: Cell, claim: Criterion) -> Iterator[str]:
    """Yield how a cell misses what is asked: flights that end otherwise, or else quantities beyond their limits."""
    others = cell["flights"] - _sum([cell], claim.outcomes)
    if others:
        yield f"{others} of {cell['flights']} not {' or '.join(claim.outcomes)}"
        return
    for column, limit in claim.at_most.items():
        if not cell[column] <= limit:
            yield _value(column, cell[column])


def _ranges(cells: Sequence[Cell], columns: Iterable[str]) -> Iterator[str]:
    """Yield the medians of the greatest rotation errors, the greatest, and the ranges of other columns."""
    medians, worst = (
        [cell[f"rotation_error_deg_{end}"] for cell in cells if cell[f"rotation_error_deg_{end}"] is not None]
        for end in ("median", "worst")
    )
    if worst:
        yield f"rotation error in the median {_range(medians)}°, at most {max(worst):.1f}°"
    for column in columns:
        if not column.startswith("rotation_error_deg"):
            yield f"{column.replace('_', ' ')} {_value(column, max(cell[column] for cell in cells))}"


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.1f}", f"{max(values):.1f}"
    return low if low == high else f"{low} to {high}"


def _value(column: str, value: float) -> str:
    unit = next((unit for name, unit in UNITS.items() if column.startswith(name)), "")
    return f"{value:.{1 if unit == '°' else 3}f}{unit}" if unit else f"{value:g}"


def _label(cell: Cell, axes: Sequence[str]) -> str:
    return ", ".join(f"{cell[axis]:g}" if isinstance(cell[axis], float) else str(cell[axis]) for axis in axes)
