"""Results of studies as the figures see them: folders beside that of the flights, read and never written."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from paper_figs.runs import MissingRun, as_typed, read


def load(results: Path, kind: str, name: str) -> xr.Dataset:
    """Read the study of a kind, with its name as an attribute; `results` is the folder of flights beside it."""
    path = results.parent / kind / name / "run.nc"
    if not path.is_file():
        command = "train" if kind == "training" else kind.replace("_", "-")
        words = as_typed(name, {"training": " --dataset FILE", "trim": " --map"}.get(kind, ""))
        makes = f"python -m experiments {command} {words}"
        raise MissingRun(f"no study `{name}` in {path.parents[1]}; make it with: {makes}")
    return read(path).assign_attrs(name=name)
