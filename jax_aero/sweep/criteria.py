"""Criteria of the claims in the file of a sweep: which cells decide one, and what must hold in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal, TypeAlias

import msgspec

from jax_aero.base import tables
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import ConfigError
from jax_aero.sweep import columns

Counted: TypeAlias = Literal["completed", "upright", "on_course", "lost", "unwarned", "degraded", "flights"]
"""Columns of the table of cells that are numbers of flights. One way of being lost is none: a claim counts all."""


class Share(tables.Table, frozen=True):
    """A greatest share of some flights among others, in all cells together."""

    of: Counted
    """The flights that are counted."""
    at_most: tables.Fraction
    among: Counted = "flights"
    """The flights that they are a share of."""


class Criterion(tables.Table, frozen=True):
    """A statement that a sweep decides: in each of the chosen cells all flights succeed, within limits."""

    key: Annotated[str, msgspec.Meta(pattern=r"^\w+$")]
    """Name of the claim in the report."""
    states: str
    cells: dict[str, Any] = msgspec.field(default_factory=dict)
    """Levels by axis, one or a list; in a text `*` stands for any characters. All levels of the other axes."""
    at_most: dict[str, float] = msgspec.field(default_factory=dict)
    """Greatest values of columns of the table of cells, such as `rotation_error_deg_p90_of_all`."""
    success: Literal["completed", "upright"] = "completed"
    """The flights that succeed."""
    share: tuple[Share, ...] = ()
    """The criterion in place of success: shares of the flights of all cells."""

    def covers(self, cell: Mapping[str, Any]) -> bool:
        """Return whether a cell is one of those that decide."""
        return all(any(_fits(cell[axis], level) for level in _listed(levels)) for axis, levels in self.cells.items())

    def check(self, levels: Mapping[str, Sequence[str | float]], key: str) -> None:
        """Refuse columns, axes and levels that a sweep has not; a sampled axis has no levels to choose from."""
        for column in self.at_most:
            if column not in columns.CELLS:
                raise ConfigError.of(
                    f"{key}.at_most", column, f"a column of cells{did_you_mean(column, columns.CELLS)}"
                )
        for axis, chosen in self.cells.items():
            known = levels.get(axis, ())
            for level in _listed(chosen):
                if not any(_fits(label, level) for label in known):
                    raise ConfigError.of(f"{key}.cells.{axis}", level, f"a level of an axis: {', '.join(levels)}")


def _listed(levels: Any) -> Sequence[Any]:
    return levels if isinstance(levels, list | tuple) else [levels]


def _fits(label: str | float, level: Any) -> bool:
    return fnmatchcase(label, level) if isinstance(label, str) and isinstance(level, str) else bool(label == level)
