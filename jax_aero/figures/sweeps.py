"""Sweeps in figures: what is drawn of them, and how axes and levels are named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from jax_aero.base import documents, quantities
from jax_aero.base.quantities import Shown
from jax_aero.base.terminal import Refused
from jax_aero.figures.runs import MissingRun, NotDrawn
from jax_aero.sweep import populations
from jax_aero.sweep import result as results
from jax_aero.sweep.result import SweepResult


def load(folder: Path, name: str, of: Sequence[str] = ()) -> SweepResult:
    """Read the sweep of this name, to draw these figures of merit, or the usual ones."""
    if not results.is_finished(folder / name):
        raise MissingRun(f"no finished sweep `{name}`; fly it with: jax-aero sweep {name}")
    try:
        sweep = results.read(folder / name, documents.DrawnSweep)
    except Refused as reason:
        raise MissingRun(str(reason)) from reason
    return replace(sweep, of=tuple(of)) if of else sweep


def require(sweep: SweepResult, suits: bool, expected: str) -> None:
    """Refuse to draw a sweep with unsuitable axes."""
    if not suits:
        panels = f" and panels {sweep.document['panels']}" if sweep.document["panels"] else ""
        raise NotDrawn(
            f'`drawing` is "{sweep.document["drawing"]}" of the axes {", ".join(sweep.names)}{panels}; '
            f"expected {expected}. Change the sweep's file and repeat the sweep: it flies nothing again"
        )


def shown_figure(column: str, table: pd.DataFrame, quantile: str = "") -> Shown:
    """Return a figure of merit of flights as it is shown, or its quantile of upright flights from a table of cells."""
    name = populations.quantile(column, quantile, populations.OF_UPRIGHT) if quantile else column
    return quantities.shown(quantities.COLUMNS[column], table[name])


def axis_label(axis: dict[str, Any]) -> str:
    """Return label and unit of an axis."""
    return f"{axis['label']} [{axis['unit']}]" if axis["unit"] else str(axis["label"])


def level_label(axis: dict[str, Any], level: object) -> str:
    """Return a level with the label of its axis, and its unit."""
    shown = f"{level:g}" if isinstance(level, float) else str(level)
    return f"{axis['label']}: {shown} {axis['unit']}".rstrip()
