"""Data of a report, read once: flights, ground experiments, sweeps."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from experiments import Refused, outdated
from experiments.report.findings import ANOTHER
from experiments.report.measures import flight, standing
from jax_aero import rust
from jax_aero.base import documents, places
from jax_aero.base.files import find_damaged, read_json
from jax_aero.base.parquet import read_rows

Cell = Mapping[str, Any]
Flown = TypeVar("Flown")

FAILED = "failed.json"
"""File of a results folder: the commands of `make reproduce` that failed, each with the reason."""


class NotFlownError(Exception):
    """A measurement is missing; the message names the command that makes it."""


class StaleError(NotFlownError):
    """A result is of another configuration or code than today's, and is therefore refused."""


@dataclass(frozen=True)
class Sweep:
    """One finished sweep."""

    document: dict[str, Any]
    cells: list[dict[str, Any]]
    differs: str = ""
    """Difference of its configuration from the present one; empty if there is none."""

    def cell(self, **labels: object) -> Cell:
        """Return the only cell with these levels; `KeyError` if there is none, as in a sweep of other levels."""
        found = self.select(**labels)
        if not found:
            raise KeyError(", ".join(f"{name} = {label}" for name, label in labels.items()))
        (cell,) = found
        return cell

    def select(self, **labels: object) -> list[dict[str, Any]]:
        """Return the cells with these levels."""
        return [cell for cell in self.cells if all(cell[name] == label for name, label in labels.items())]

    def levels(self, axis: str) -> list[Any]:
        """Return the levels of an axis, in order."""
        return list(dict.fromkeys(cell[axis] for cell in self.cells))


class Origin(NamedTuple):
    """Origin of a result."""

    created: str
    """Time of creation; empty if unknown."""
    commit: str | None
    differs: str
    """Difference of its configuration from the present one; empty if there is none."""


@dataclass(frozen=True)
class Results:
    """A results folder."""

    folder: Path
    stale: bool = False
    """Whether results of another configuration or code are used, and marked, instead of refused."""
    made: dict[str, Origin] = field(default_factory=dict)
    """Origins of the results that were used, by name."""

    @cached_property
    def failed(self) -> dict[str, str]:
        """Return the commands of the last `make reproduce` that failed, each with the reason."""
        path = self.folder / FAILED
        return read_json(path, dict[str, str]) if path.is_file() else {}

    def failures(self, commands: Iterable[str]) -> list[str]:
        """Return which of these commands failed, and why."""
        return [f"`{command}` failed: {self.failed[command]}" for command in commands if command in self.failed]

    def note(self, name: str, document: Mapping[str, Any], differs: str) -> None:
        """Record the origin of a result."""
        created = document.get("finished", document).get("created", "")
        self.made[name] = Origin(created, (document.get("git") or {}).get("commit"), differs)

    @cached_property
    def manifests(self) -> dict[str, dict[str, Any]]:
        """Return the manifests of flights without --set, by name; others are not the paper's."""
        found = {}
        for folder in sorted((self.folder / "flight").glob("[!.]*")):
            path = folder / places.MANIFEST_FILE
            if "--" not in folder.name and os.path.lexists(path):
                found[path.parent.name] = read_json(path, documents.Manifest)
                _require_whole(path.parent, found[path.parent.name])
        return found

    @cached_property
    def differences(self) -> dict[str, str]:
        """Return the difference of every such flight from today's, by name."""
        return {name: outdated.flight(name, document) for name, document in self.manifests.items()}

    @cached_property
    def flights(self) -> dict[str, flight.Metrics]:
        """Return the metrics of every flight without --set, by name, unless it is refused."""
        return {name: flight.read(self.folder / "flight" / name) for name in self._used(self.differences)}

    def _used(self, differences: Mapping[str, str]) -> list[str]:
        return [name for name, difference in differences.items() if self.stale or not difference]

    @cached_property
    def refused(self) -> dict[str, str]:
        """Return the flights and sweeps that are of another configuration or code, with the difference."""
        flights = {name: self.differences[name] for name in self.manifests if name not in self.flights}
        return flights | {
            f"sweep {name}": sweep.differs for name, sweep in self._finished.items() if name not in self.sweeps
        }

    @cached_property
    def ground_experiments(self) -> dict[str, standing.Ground]:
        """Return the metrics of every ground experiment without --set, by name."""
        mass = rust.Robot(str(places.ROBOT)).mass
        read = (
            standing.read(self.folder / "flight" / name, self.manifests[name].get("config", {}), mass)
            for name in self._used(self.differences)
        )
        return {found.name: found for found in read if found is not None}

    @cached_property
    def sweeps(self) -> dict[str, Sweep]:
        """Return every finished sweep, by name, unless it is refused."""
        used = self._used({name: sweep.differs for name, sweep in self._finished.items()})
        return {name: self._finished[name] for name in used}

    @cached_property
    def _finished(self) -> dict[str, Sweep]:
        found = {}
        for path in sorted((self.folder / "sweeps").glob("*/cells.parquet")):
            described = path.with_name("sweep.json")
            if "finished" in read_json(described):
                document = read_json(described, documents.FinishedSweep)
                _require_whole(path.parent, document["finished"])
                name, (columns, cells) = path.parent.name, read_rows(path)
                axes = [axis["name"] for axis in document["axes"]]
                if missing := {*axes, "flights", "completed"} - set(columns):
                    raise Refused(f"{path} has no column `{min(missing)}`; --overwrite flies it again")
                found[name] = Sweep(document, cells, outdated.sweep(path.parent, document))
        return found

    def flight(self, name: str) -> flight.Metrics:
        """Return the metrics of a flight without --set."""
        return self._find(self.flights, name)

    def ground_experiment(self, name: str) -> standing.Ground:
        """Return the metrics of a ground experiment without --set."""
        return self._find(self.ground_experiments, name)

    def _find(self, found: Mapping[str, Flown], name: str) -> Flown:
        self._refuse(name, self.differences.get(name, ""))
        if name not in found:
            raise NotFlownError(f"`jax-aero fly {name}` has not been run")
        self.note(name, self.manifests[name], self.differences[name])
        return found[name]

    def sweep(self, name: str) -> Sweep:
        """Return a finished sweep without failed flights."""
        if name not in self._finished:
            raise NotFlownError(f"`jax-aero sweep {name}` has not been run")
        found = self._finished[name]
        self._refuse(f"sweep {name}", found.differs)
        if failed := found.document["finished"]["outcomes"].get("error"):
            raise NotFlownError(f"{failed} flights of `jax-aero sweep {name}` could not be flown")
        self.note(f"sweep {name}", found.document, found.differs)
        return found

    def study(self, kind: str, name: str) -> dict[str, Any]:
        """Return the figures of a study."""
        path = self.folder / kind / name / places.MANIFEST_FILE
        if not path.is_file():
            command = "cfd flow" if kind == "cfd_flow" else f"study {kind}"
            raise NotFlownError(f"`jax-aero {command} {name}` has not been run")
        document = read_json(path, documents.Manifest)
        differs = outdated.study(kind, name, document)
        self._refuse(f"{kind} {name}", differs)
        self.note(f"{kind} {name}", document, differs)
        return dict(document.get("summary", {}))

    def _refuse(self, name: str, differs: str) -> None:
        if differs and not self.stale:
            raise StaleError(f"{ANOTHER}: {name} ({differs})")

    def figures(self, name: str) -> dict[str, str]:
        """Return the paths of a figure, relative to the report, by the runs it shows; "" for its default runs."""
        drawn = [self.folder / "figures" / f"{name}.png", *sorted(self.folder.glob(f"figures/{name}--*.png"))]
        return {
            path.stem.removeprefix(name).removeprefix("--"): f"figures/{path.name}" for path in drawn if path.is_file()
        }


def _require_whole(folder: Path, document: Mapping[str, Any]) -> None:
    if name := find_damaged(folder, document.get("files") or {}):
        raise Refused(f"{folder / name} is not what was written there; --overwrite flies it again")


def count(cell: Cell) -> str:
    """Return "39 of 40 (87 to 100 %)": the number that complete, and its 95 % interval."""
    low, high = (100.0 * cell[f"completed_{end}"] for end in ("low", "high"))
    return f"{cell['completed']} of {cell['flights']} ({low:.0f} to {high:.0f} %)"
