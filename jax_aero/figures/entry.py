"""A figure of single flights, studies or tables, with the results it shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from matplotlib.figure import Figure

from jax_aero.base import kinds
from jax_aero.data import tables
from jax_aero.figures import runs


@dataclass(frozen=True)
class Entry:
    """A figure: its drawing function and the results it shows."""

    draw: Callable[..., Figure]
    """Function of the results in order, a dataset for each; or else of the tables."""
    shows: str
    kind: str = ""
    """Kind of the results: "flight" or a kind of study; empty without results."""
    runs: tuple[str, ...] = ()
    """Names of the results that are shown by default; none for a figure of those that are asked for."""
    tables: tuple[str, ...] = ()
    """Files of `configs/tables` that are shown if there are no results."""

    @property
    def is_of_any(self) -> bool:
        """Return whether it shows any number of results, which have to be named."""
        return bool(self.kind) and not self.runs

    @property
    def commands(self) -> list[str]:
        """Return the commands that make the results; none if committed tables are shown."""
        kind = kinds.find(self.kind)
        return [kind.line(" ".join(self.runs))] if self.kind == "flight" else [kind.line(name) for name in self.runs]

    def folders(self, results: Path, names: Sequence[str] = ()) -> list[Path]:
        """Return the folders of the results that it shows."""
        return [runs.folder_of(results, self.kind, name) for name in names or self.runs]

    def draw_from_results(
        self, results: Path, names: Sequence[str] = (), labels: Sequence[str] = ()
    ) -> tuple[Figure, dict[str, str]]:
        """Return the figure, and the hash of every result or table that it shows; flights have labels, or names."""
        try:
            return self._load_and_draw(results, names or self.runs, labels)
        except KeyError as missing:
            what = str(missing.args[0]).partition(". ")[0]
            raise runs.NotDrawn(
                f"{what}: other code made the result; make it again: {'; '.join(self.commands)}"
            ) from None

    def _load_and_draw(
        self, results: Path, names: Sequence[str], labels: Sequence[str]
    ) -> tuple[Figure, dict[str, str]]:
        if self.tables:
            return self.draw(*map(tables.read, self.tables)), tables.hashes(*self.tables)
        if self.kind == "flight":
            loaded = [runs.load(results, *named) for named in zip_longest(names, labels)]
        else:
            loaded = [runs.load_study(results, self.kind, name) for name in names]
        return self.draw(*loaded), {run.attrs["name"]: str(run.attrs["config_hash"]) for run in loaded}
