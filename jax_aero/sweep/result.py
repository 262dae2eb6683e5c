"""A finished sweep as it is read: by figures, report and pages, from its folder or from what is kept of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from jax_aero.base import documents, places, sizes
from jax_aero.base.files import find_damaged, read_json
from jax_aero.base.kinds import KINDS
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import Refused
from jax_aero.results.record import files_of
from jax_aero.sweep.perturbation import perturbed

FLIGHTS, CELLS = KINDS["sweeps"].files


@dataclass(frozen=True)
class SweepResult:
    """One finished sweep."""

    name: str
    document: Mapping[str, Any]
    """Its description: title, axes, `drawing` and `panels`; of a folder, all of `sweep.json`."""
    cells: pd.DataFrame
    """A row for each cell, with its levels and the columns of `sweep.columns.CELLS`."""
    each: str = ""
    """How many flights a cell has, and how they differ."""
    folder: Path | None = None
    """Its folder; `None` if it is kept without its flights."""
    of: tuple[str, ...] = ("max_rotation_error_deg", "max_com_error")
    """Figures of merit that a figure shows, by their columns."""

    @cached_property
    def flights(self) -> pd.DataFrame:
        """Return a row for each flight, with the columns of `sweep.columns.FLIGHTS`."""
        if self.folder is None:
            raise Refused(f"of {self.name} no flights are kept")
        return _frame(self.folder / FLIGHTS)

    @property
    def title(self) -> str:
        """Return the title of the sweep."""
        return str(self.document["title"])

    @property
    def hashes(self) -> dict[str, str]:
        """Return the hash stored in a figure."""
        return {f"sweep {self.name}": str(self.document["config_digest"])}

    @property
    def names(self) -> list[str]:
        """Return the names of all axes."""
        return [axis["name"] for axis in self.document["axes"]]

    @property
    def axes(self) -> list[dict[str, Any]]:
        """Return name, label, unit and levels of the axes within a panel."""
        return [axis for axis in self.document["axes"] if axis["name"] != self.document["panels"]]

    @property
    def panel_axis(self) -> dict[str, Any] | None:
        """Return the axis whose levels are panels or lines, or `None`."""
        panels = self.document["panels"]
        return next((axis for axis in self.document["axes"] if axis["name"] == panels), None)

    def is_numeric(self, axis: Mapping[str, Any]) -> bool:
        """Return whether the levels of an axis are numbers."""
        return bool(pd.api.types.is_float_dtype(self.cells[axis["name"]]))

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """Return the cells as tables, in which `None` stands for what is unknown."""
        columns = self.cells.astype(object)
        return [dict(row) for row in columns.where(self.cells.notna(), None).to_dict("records")]

    def select(self, **labels: object) -> list[dict[str, Any]]:
        """Return the cells with these levels."""
        return [cell for cell in self.rows if all(cell[name] == label for name, label in labels.items())]

    def cell(self, **labels: object) -> dict[str, Any]:
        """Return the only cell with these levels; `KeyError` if there is none, as in a sweep of other levels."""
        cells = self.select(**labels)
        if not cells:
            raise KeyError(", ".join(f"{name} = {label}" for name, label in labels.items()))
        (cell,) = cells
        return cell

    def levels(self, axis: str) -> list[Any]:
        """Return the levels of an axis, in order."""
        return list(dict.fromkeys(cell[axis] for cell in self.rows))


def is_finished(folder: Path) -> bool:
    """Return whether a folder holds a finished sweep."""
    return (folder / CELLS).is_file()


def read(folder: Path, form: Any = documents.FinishedSweep) -> SweepResult:
    """Read the finished sweep of a folder.

    Raises
    ------
    Refused
        If a file is not what was written there, or of another form; the message names it, and the remedy.
    """
    document = read_json(folder / places.SWEEP_FILE, form)
    if name := find_damaged(folder, files_of(document)):
        raise Refused(f"{folder / name} is not what was written there; --overwrite flies it again")
    cells, names = _frame(folder / CELLS, sizes.MAX_OBJECTS), [axis["name"] for axis in document["axes"]]
    if missing := {*names, "flights", "completed"} - {*cells.columns}:
        raise Refused(f"{folder / CELLS} has no column `{min(missing)}`; --overwrite flies it again")
    return SweepResult(folder.name, document, cells, _each(document), folder)


def _frame(path: Path, most: int | None = None) -> pd.DataFrame:
    try:
        return read_table(path, most).to_pandas(use_threads=False)
    except Refused as reason:
        raise Refused(f"{reason}; --overwrite flies it again") from None


def _each(document: Mapping[str, Any]) -> str:
    n = document["repeats"]
    return f"{'one flight' if n == 1 else f'{n} flights'} each, {perturbed(document['perturbation'])}"
