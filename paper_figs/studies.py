"""Results of studies, read for figures from folders beside that of the flights; never written."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from paper_figs.runs import MissingRun, read, result_words


def load(results: Path, kind: str, name: str) -> xr.Dataset:
    """Read a study of a kind, with its name as an attribute; `results` is the folder of flights beside it."""
    path = results.parent / kind / name / "run.nc"
    if not path.is_file():
        raise MissingRun(f"no study `{name}` in {path.parents[1]}; make it with: {command(kind, name)}")
    return read(path).assign_attrs(name=name)


def command(kind: str, name: str) -> str:
    """Return the command that makes a study."""
    word = "train" if kind == "training" else kind.replace("_", "-")
    options = {"training": " --dataset FILE", "trim": " --map"}.get(kind, "")
    return f"python -m experiments {word} {result_words(name, options)}"
