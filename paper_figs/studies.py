"""Results of studies as the figures see them: folders beside that of the flights, read and never written."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from paper_figs.runs import MissingRun

COMMANDS = {
    "observer_limit": "python -m experiments observer-limit",
    "tip_over": "python -m experiments tip-over",
    "fit": "python -m experiments fit-aero",
    "training": "python -m experiments train compact --dataset results/datasets/freestream.nc",
    "surrogate": "python -m experiments calibrate-surrogate",
    "identify_engine": "python -m experiments identify-engine",
    "arm_engines": "python -m experiments arm-engines",
    "along": "python -m experiments along",
    "pictures": "python -m experiments pictures",
    "identify": "python -m experiments identify-aero",
}
"""What makes a study, where that is not `python -m experiments.KIND NAME`."""


def load(results: Path, kind: str, name: str) -> xr.Dataset:
    """Read the study of a kind and name; `results` is the folder of flights, beside which studies lie."""
    path = results.parent / kind / name / "run.nc"
    if not path.is_file():
        option = " --map" if kind == "trim" else ""
        command = COMMANDS.get(kind, f"python -m experiments.{kind} {name}{option}")
        raise MissingRun(f"no study `{name}` in {path.parents[1]}; make it with: {command}")
    return xr.load_dataset(path, engine="h5netcdf")
