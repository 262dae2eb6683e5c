"""Sweep folders, read for figures: cells with counts and intervals; never written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from jax_aero.base import documents, quantities
from jax_aero.base.files import read_json
from jax_aero.base.parquet import read_table
from jax_aero.base.quantities import Shown
from jax_aero.base.terminal import Refused
from jax_aero.figures.runs import MissingRun, NotDrawn
from jax_aero.sweep.perturbation import perturbed


@dataclass(frozen=True)
class Sweep:
    """One finished sweep."""

    name: str
    document: dict[str, Any]
    folder: Path
    of: tuple[str, ...] = field(default=("max_rotation_error_deg", "max_com_error"), kw_only=True)
    """Figures of merit that are drawn, by their columns."""

    @cached_property
    def cells(self) -> pd.DataFrame:
        """Return one row per cell."""
        return _read(self.folder / "cells.parquet")

    @cached_property
    def flights(self) -> pd.DataFrame:
        """Return one row per flight."""
        return _read(self.folder / "table.parquet")

    @property
    def title(self) -> str:
        """Return the title of the sweep."""
        return str(self.document["title"])

    @property
    def hashes(self) -> dict[str, str]:
        """Return the hash stored in a figure."""
        return {f"sweep {self.name}": str(self.document["config_digest"])}

    @property
    def axes(self) -> list[dict[str, Any]]:
        """Return name, label, unit and levels of the variables within a panel."""
        return [axis for axis in self.document["axes"] if axis["name"] != self.document["panels"]]

    @property
    def panel_axis(self) -> dict[str, Any] | None:
        """Return the axis whose levels are panels or lines, or `None`."""
        panels = self.document["panels"]
        return next((axis for axis in self.document["axes"] if axis["name"] == panels), None)

    def is_numeric(self, axis: dict[str, Any]) -> bool:
        """Return whether the levels of an axis are numbers."""
        return bool(pd.api.types.is_float_dtype(self.cells[axis["name"]]))

    def require(self, suits: bool, expected: str) -> None:
        """Refuse to draw a sweep with unsuitable axes."""
        if not suits:
            names = ", ".join(axis["name"] for axis in self.document["axes"])
            panels = f" and panels {self.document['panels']}" if self.document["panels"] else ""
            raise NotDrawn(
                f'`drawing` is "{self.document["drawing"]}" of the axes {names}{panels}; expected {expected}. '
                "Change the sweep's file and repeat the sweep: it flies nothing again"
            )

    spread = "median, 10 to 90 % of all flights"
    """What the centres and intervals of errors are."""

    def footnote(self) -> str:
        """Return the number of flights per point, and how they differ."""
        n = self.document["repeats"]
        return f"{'one flight' if n == 1 else f'{n} flights'} each, {perturbed(self.document['perturbation'])}"


def is_finished(folder: Path) -> bool:
    """Return whether a folder holds a finished sweep."""
    return (folder / "cells.parquet").is_file()


def load(results: Path, name: str, of: Sequence[str] = ()) -> Sweep:
    """Read the sweep of this name, and draw these figures of merit, or the usual ones."""
    folder = results / name
    if not is_finished(folder):
        raise MissingRun(f"no finished sweep `{name}`; fly it with: jax-aero sweep {name}")
    try:
        document = read_json(folder / "sweep.json", documents.DrawnSweep)
        return Sweep(name, document, folder, of=tuple(of)) if of else Sweep(name, document, folder)
    except Refused as reason:
        raise MissingRun(f"{reason}; --overwrite flies it again") from reason


def _read(path: Path) -> pd.DataFrame:
    try:
        return read_table(path).to_pandas(use_threads=False)
    except Refused as reason:
        raise MissingRun(f"{reason}; --overwrite flies it again") from reason


def shown_figure(column: str, table: pd.DataFrame, quantile: str = "") -> Shown:
    """Return a figure of merit of flights as it is shown, or a quantile of it from a table of cells."""
    name = f"{column.removeprefix('max_')}_{quantile}" if quantile else column
    return quantities.shown(quantities.COLUMNS[column], table[name])


def axis_label(axis: dict[str, Any]) -> str:
    """Return label and unit of an axis."""
    return f"{axis['label']} [{axis['unit']}]" if axis["unit"] else str(axis["label"])


def level_label(axis: dict[str, Any], level: object) -> str:
    """Return a level with the label of its axis, and its unit."""
    shown = f"{level:g}" if isinstance(level, float) else str(level)
    return f"{axis['label']}: {shown} {axis['unit']}".rstrip()
