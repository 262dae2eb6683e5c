"""Verify the open solver on bodies of known drag and on the robot: `jax-aero cfd verify NAME`.

NAME is `sphere`, `cylinder` (free ends, five diameters long, across the wind), both at a Reynolds number of 1e5, or a
posture, in head wind at the pitch at which it flies. Simulated are three meshes, each about `ratio` times finer than
the one before (a cube has a whole number of cells), then the coarsest with twice the iterations and in a larger cube of
the same cells. With edges h of the cells at the surface, order p and limit C_∞ follow from Richardson extrapolation,

    C = C_∞ + K h^p,      (C₁ − C₂)/(C₂ − C₃) = (h₁^p − h₂^p)/(h₂^p − h₃^p)

and are given only if there is a solution p > 0. Needs OpenFOAM.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import xarray as xr
from scipy.optimize import brentq

from jax_aero import rust
from jax_aero.aero.dataset import Floats, wind_direction
from jax_aero.base import tables
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.cfd import foam
from jax_aero.cfd.geometry import Surface, robot_surfaces, triangles_of
from jax_aero.cfd.goals import verdicts
from jax_aero.cfd.settings import Mesh, Settings, Shell
from jax_aero.cfd.simulate import Result, simulate
from jax_aero.data.import_cfd import POSTURES, known_postures
from jax_aero.results.study import Findings, Study

DIAMETER = 0.0864
"""Diameter of sphere and cylinder [m], for a Reynolds number of 1e5 at 17 m/s; about that of an arm."""
FLIES_AT = {"flight30": 30.0, "flight50": 50.0, "flight60": 60.0}
"""Pitch of the postures of forward flight [deg]; others hover at 90°."""


class Subject(NamedTuple):
    """Body to simulate."""

    surfaces: Mapping[str, Surface]
    wind_b: Floats
    area: float
    """Reference area of the drag coefficient [m²]."""
    literature: float | None
    source: str
    mesh: Mesh
    """Settings of the coarsest mesh."""


class VerifyConfig(tables.Table, frozen=True):
    """Settings of a verification."""

    ratio: tables.Positive = 4.0 / 3.0
    """Approximate ratio of the cell edges of successive meshes."""
    iterations: tables.Count = 160
    """Iterations of every solution."""


def subject_of(name: str) -> Subject:
    """Return the body of a name."""
    around = Mesh(
        half_width=2.0,
        base=0.42,
        surface_level=6,
        shells=tuple(Shell(distance=d, level=n) for d, n in ((0.012, 6), (0.03, 5), (0.08, 4), (0.2, 3), (0.6, 2))),
    )
    if name == "sphere":
        body = Surface(triangles_of("sphere", (0.5 * DIAMETER,) * 3), np.zeros(3))
        source = "0.47, White, Fluid Mechanics, table 7.3; 0.5, Achenbach 1972: before the drag crisis at 3e5"
        return Subject({name: body}, np.array([1.0, 0.0, 0.0]), np.pi * DIAMETER**2 / 4, 0.47, source, around)
    if name == "cylinder":
        length = 5.0 * DIAMETER
        body = Surface(triangles_of("cylinder", (0.5 * DIAMETER, 0.5 * DIAMETER, length)), np.zeros(3))
        source = "0.74, White, Fluid Mechanics, table 7.3 (after Wieselsberger), length 5 diameters, free ends"
        return Subject({name: body}, np.array([1.0, 0.0, 0.0]), DIAMETER * length, 0.74, source, around)
    known = known_postures()
    if name not in known:
        raise Refused(f"no `{name}`; there are sphere, cylinder, {', '.join(known)}")
    surfaces = robot_surfaces(rust.Robot(ROBOT), known[name])
    return Subject(surfaces, wind_direction(FLIES_AT.get(name, 90.0), 0.0), 1.0, None, "", Mesh(base=0.9))


def compute(name: str, config: VerifyConfig) -> Findings:
    """Simulate and extrapolate."""
    foam.environment()
    subject = subject_of(name)
    coarsest = subject.mesh
    meshes = [msgspec.structs.replace(coarsest, base=coarsest.base / config.ratio**number) for number in range(3)]
    edge = coarsest.edge(0)
    across = coarsest.cells_across + 2 * math.ceil(0.3 * coarsest.cells_across)
    wider = msgspec.structs.replace(coarsest, base=edge, half_width=0.5 * across * edge)
    solver = msgspec.structs.replace(Settings().solver, iterations=config.iterations)
    longer = msgspec.structs.replace(solver, iterations=2 * config.iterations)
    plans = {f"cells of {1e3 * mesh.finest:.2f} mm": (mesh, solver) for mesh in meshes}
    plans |= {"coarsest, twice the iterations": (coarsest, longer), "coarsest, larger cube": (wider, solver)}
    results: dict[str, Result] = {}
    for label, (mesh, chosen) in plans.items():
        with tempfile.TemporaryDirectory(prefix="jax-aero-cfd-") as scratch:
            settings = Settings(mesh=mesh, solver=chosen)
            (results[label],) = simulate(subject.surfaces, [subject.wind_b], settings, Path(scratch))
        print(f"{name}, {label}: {results[label].reason or coefficient(results[label], subject)}", flush=True)
    values = np.array([coefficient(result, subject) for result in results.values()])
    summary: dict[str, Any] = {label: float(value) for label, value in zip(plans, values, strict=True)}
    areas = np.array([link_areas(result, subject) for result in results.values()])
    off = areas - areas[2]
    for label, links in zip(plans, off, strict=True):
        summary[f"{label}: total force from that of the finest mesh [m2]"] = float(np.linalg.norm(links.sum(axis=0)))
        summary[f"{label}: links from those of the finest mesh, mean square [m4]"] = float(np.mean(links**2))
    summary |= {f"{label}: cells": result.quality.get("cells") for label, result in results.items()}
    summary |= {f"{label}: y+ mean": result.quality.get("y+ mean") for label, result in results.items()}
    summary |= {f"{label}: refused": result.reason for label, result in results.items() if result.reason}
    is_refused = any(result.reason for result in [*results.values()][:3])
    none = {"observed order": "none: a mesh has no steady solution"}
    summary |= none if is_refused else extrapolate(values[:3], np.array([mesh.finest for mesh in meshes]))
    summary["twice the iterations change it by"] = float(values[3] / values[0] - 1.0)
    summary["the larger cube changes it by"] = float(values[4] / values[0] - 1.0)
    if subject.literature is not None:
        summary |= {"literature": subject.literature, "source": subject.source}
        summary["finest over literature"] = float(values[2] / subject.literature)
        summary |= verdicts({"drag coefficient, relative error": summary["finest over literature"] - 1.0})
    data = xr.Dataset(
        {
            "drag": ("run", values, {"long_name": "coefficient; of a posture the area in m2"}),
            "force_area_b": (("run", "link", "xyz"), areas, {"units": "m2"}),
        },
        {"run": [*plans], "link": [*subject.surfaces], "xyz": ["x", "y", "z"]},
    )
    return Findings(f"Open CFD verified: {name}", data, summary, files=[ROBOT, POSTURES])


def coefficient(result: Result, subject: Subject) -> float:
    """Return the drag coefficient on the reference area; NaN if refused."""
    return float(link_areas(result, subject).sum(axis=0) @ subject.wind_b / subject.area)


def link_areas(result: Result, subject: Subject) -> Floats:
    """Return the force areas (L, 3) [m²], base axes; NaN if refused."""
    return np.array([result.force_area_b.get(name, (np.nan,) * 3) for name in subject.surfaces])


def extrapolate(values: Floats, edges: Floats) -> dict[str, float | str]:
    """Return observed order and limit of values (3,) on meshes with these edges, or that there is none."""
    first, second = values[0] - values[1], values[1] - values[2]
    coarse, fine = np.log(edges[[0, 2]] / edges[1])
    ratio = first / second if second else np.nan
    spread = {"finest and middle mesh differ by": float(abs(second / values[2]))}
    if not ratio > -coarse / fine:  # the limit for p → 0
        return {**spread, "observed order": "none: the three values do not converge"}

    def lack(p: float) -> float:
        return float(np.expm1(p * coarse) / -np.expm1(p * fine) - ratio)

    order = brentq(lack, 1e-6, math.log1p(ratio) / coarse)
    return {**spread, "observed order": order, "extrapolated": float(values[2] - second / np.expm1(-order * fine))}


STUDY = Study(
    "cfd_verify",
    __doc__,
    VerifyConfig,
    compute,
    ("sphere", "cylinder", "hovering"),
    backend="openfoam",
)
main = STUDY.main
