"""Kinds of results: the folder of each below `results/`, the command that makes it, and its files."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from jax_aero.base import places


@dataclass(frozen=True)
class Kind:
    """One kind of results."""

    name: str
    """Name of its folder."""
    command: str
    """Words of its command, before the name of a result."""
    needs: str = ""
    """Words that the command needs after the name."""
    files: tuple[str, ...] = (places.RUN_FILE,)
    """Files that every result has, beside the manifest."""
    manifest: str = places.MANIFEST_FILE

    def folders(self, results: Path) -> list[Path]:
        """Return the folders of its results."""
        return sorted(path for path in (results / self.name).glob("[!.]*") if path.is_dir())

    def line(self, name: str, *, options: str = "") -> str:
        """Return the command of a result: `test2--wind.seed=3` is `test2` with a change."""
        stem, changed, _ = name.partition("--")
        words = ("jax-aero", self.command, stem, self.needs, options, changed and "--set ... (the changes in its name)")
        return " ".join(word.strip() for word in words if word)


KINDS = {
    kind.name: kind
    for kind in (
        Kind("flight", "fly"),
        Kind("sweeps", "sweep", files=("table.parquet", "cells.parquet"), manifest=places.SWEEP_FILE),
        Kind("training", "train", "--dataset FILE"),
        Kind("training_flights", "train flights --base", "LOG ..."),
        Kind("training_search", "train search", "--dataset FILE", files=("trials.csv",)),
        Kind("fit_aero", "data fit-aero"),
        Kind("cfd", "cfd", files=("dataset.nc", "cases.json")),
        *(Kind(f"cfd_{part}", f"cfd {part}") for part in ("compare", "flow", "taps", "tunnel", "verify")),
    )
}
"""Kinds by name, without the studies, each of which is a folder of `experiments/studies`."""


def find(name: str) -> Kind:
    """Return a kind by its name: one of the table, or else a study."""
    return KINDS.get(name) or Kind(name, f"study {name}", "--map" if name == "trim" else "")


def of_line(line: str) -> tuple[Kind, list[str]]:
    """Return the kind of the results that a command line makes, and its other words."""
    words = shlex.split(line)[1:]
    if words[0] == "study":
        return find(words[1].replace("-", "_")), words[2:]
    kinds = sorted(KINDS.values(), key=lambda kind: -len(kind.command.split()))
    for kind in kinds:
        own = kind.command.split()
        if words[: len(own)] == own:
            return kind, words[len(own) :]
    return Kind(words[0], words[0]), words[1:]
