"""The public tables of wind tunnel and CFD, `configs/tables`, and what follows from their numbers."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from jax_aero.base.places import CONFIGS

TABLES = CONFIGS / "tables"
TUNNEL, CFD = "wind_tunnel.toml", "cfd_tunnel.toml"

FINEST = "953C"
OMEGA, EPSILON = "SST k-omega", "realizable k-epsilon"

Array = npt.NDArray[np.float64]
Table = Mapping[str, Any]


def read(name: str) -> dict[str, Any]:
    """Read a typed table."""
    return tomllib.loads((TABLES / name).read_text(encoding="utf-8"))


def hashes(*names: str) -> dict[str, str]:
    """Return the digest of each table, which is stored in the figure."""
    return {f"tables/{name}": hashlib.sha256((TABLES / name).read_bytes()).hexdigest() for name in names}


def hovering_drag(tables: Table) -> dict[float, dict[int, float]]:
    """Return drag area by rounded speed [m/s] and sideslip [deg]; the mean where two tests overlap."""
    drag: dict[float, dict[int, list[float]]] = {}
    for table in tables["hovering"]:
        curve = drag.setdefault(float(round(table["speed"])), {})
        for beta, area in zip(table["beta_deg"], table["cda"], strict=True):
            curve.setdefault(beta, []).append(area)
    return {speed: {b: float(np.mean(curve[b])) for b in sorted(curve)} for speed, curve in sorted(drag.items())}


def flight(tables: Table, posture: str) -> Table:
    """Return the record of a flight posture."""
    record: Table = next(table for table in tables["flight"] if table["posture"] == posture)
    return record


def run_of(runs: Sequence[Table], mesh_name: str, turbulence: str) -> Table:
    """Return the simulations of flight30 with one mesh and turbulence model."""
    wanted = ("flight30", mesh_name, turbulence)
    return next(run for run in runs if (run["posture"], run["mesh"], run["turbulence"]) == wanted)


def meshes(runs: Sequence[Table]) -> list[str]:
    """Return the names of the meshes of flight30, coarsest first."""
    return sorted({run["mesh"] for run in runs if run["posture"] == "flight30"})


def measured_area(record: Table, key: str, run: Table) -> Array:
    """Return a force area of the tunnel at the angles of attack of a simulation."""
    areas = dict(zip(record["alpha_deg"], record[key], strict=True))
    return np.array([areas[alpha] for alpha in run["alpha_deg"]])


def drag_error(record: Table, run: Table) -> float:
    """Return the rms difference of the drag area over its mean in the tunnel."""
    tunnel = measured_area(record, "cda", run)
    return float(np.sqrt(np.mean((np.array(run["cda"]) - tunnel) ** 2)) / tunnel.mean())
