"""Files of an OpenFOAM case: steady incompressible flow, k-ω SST with wall functions, one mesh for all winds.

    ∇·u = 0,   ∇·(u u) = −∇p + ∇·(ν + ν_t)(∇u + ∇uᵀ),   k_∞ = 3/2 (I V)²,   ω_∞ = k_∞ / (r ν)

with the kinematic pressure p, the turbulence intensity I and the viscosity ratio r of the free stream. The wind
direction varies, not the mesh: every side of the cube is inlet or outlet, depending on the local flow direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero.aero.dataset import Floats
from jax_aero.base import tables
from jax_aero.base.files import write_text
from jax_aero.cfd.foam import TAPS
from jax_aero.cfd.geometry import Surface, write_stl
from jax_aero.cfd.settings import Air, Mesh, Settings, Solver

FAR = "far"
"""Name of the patch on the sides of the cube."""
BODY = "body"
"""Name of the geometry; its patches have the names of the links and belong to the group `wall`."""

BEFORE = 0.03
"""Distance of a point before a tap, to which the nearest face of its link is sought [m].

Taps lie up to 45 mm inside primitives, where the nearest face may be another side.
"""

Entry = Any
"""A value of a dictionary: a number, a word, verbatim text, a sequence, or a mapping."""

DICTIONARIES = Path(__file__).with_name("openfoam.toml")
FIXED: Mapping[str, Any] = tables.read(DICTIONARIES)
"""What no setting changes."""


def write_mesh_case(folder: Path, surfaces: Mapping[str, Surface], mesh: Mesh) -> None:
    """Write the input of `blockMesh` and `snappyHexMesh`."""
    write_stl(surfaces, folder / "constant" / "triSurface" / f"{BODY}.stl")
    write_control(folder, end=1, functions={})
    write_schemes(folder, is_upwind=True)
    _write(folder, "system/fvSolution", FIXED["solution"])
    _write(folder, "system/blockMeshDict", _block(mesh))
    inside = np.concatenate([surface.triangles.reshape(-1, 3) for surface in surfaces.values()])
    if np.abs(inside).max() > 0.5 * mesh.half_width:
        raise ValueError(f"`mesh.half_width` is {mesh.half_width}; expected at least twice the body's reach")
    _write(folder, "system/snappyHexMeshDict", _snappy(surfaces, mesh))


def write_wind_case(folder: Path, wind_b: Floats, settings: Settings) -> None:
    """Write fields and properties of one wind, a unit vector of the air's motion, into a meshed case."""
    _write(folder, "constant/transportProperties", {"transportModel": "Newtonian", "nu": settings.air.viscosity})
    model = {"RASModel": "kOmegaSST", "turbulence": "on", "printCoeffs": "off"}
    _write(folder, "constant/turbulenceProperties", {"simulationType": "RAS", "RAS": model})
    for name, field in _fields(settings.air, wind_b).items():
        _write(folder, f"0/{name}", field, kind="volVectorField" if name == "U" else "volScalarField")
    _write(
        folder,
        "system/decomposeParDict",
        {
            "numberOfSubdomains": settings.solver.ranks,
            "method": "hierarchical",
            "coeffs": {"n": (1, 1, settings.solver.ranks), "order": "xyz"},
        },
    )


def write_control(folder: Path, *, end: int, functions: Mapping[str, Entry]) -> None:
    """Write the last iteration of the solver, and its reports."""
    control = {**FIXED["control"], "endTime": end, "writeInterval": end, "functions": functions}
    _write(folder, "system/controlDict", control)


def write_schemes(folder: Path, *, is_upwind: bool) -> None:
    """Write the discretisation, with first- or second-order convection of the velocity."""
    convection = "bounded Gauss upwind" if is_upwind else "bounded Gauss linearUpwindV grad(U)"
    schemes = FIXED["schemes"] | {"divSchemes": FIXED["schemes"]["divSchemes"] | {"div(phi,U)": convection}}
    _write(folder, "system/fvSchemes", schemes)


def reports_of(surfaces: Mapping[str, Surface], air: Air, solver: Solver, end: int) -> dict[str, Entry]:
    """Return reports of force, couple and pressures of every link in the window before `end`, and of y+ at the end.

    Every report computes the stress in all cells, so none is made outside the window.
    """
    in_window = {
        "timeStart": end - solver.window + 1,
        "executeControl": "timeStep",
        "executeInterval": solver.sampling,
        "writeControl": "timeStep",
        "writeInterval": solver.sampling,
        "log": "false",
    }
    reports: dict[str, Entry] = {
        name: {
            "type": "forces",
            "libs": ["forces"],
            "patches": [name],
            "rho": "rhoInf",
            "rhoInf": air.density,
            "CofR": tuple(surface.centre),
            **in_window,
        }
        for name, surface in surfaces.items()
    }
    # Each is read at the face of its link that is nearest to a point before it.
    reports |= {
        f"{name}{TAPS}": {
            "type": "patchProbes",
            "libs": ["sampling"],
            "patches": [name],
            "fields": ["p"],
            "probeLocations": [tuple(tap.position + BEFORE * tap.normal) for tap in surface.taps.values()],
            **in_window,
        }
        for name, surface in surfaces.items()
        if surface.taps
    }
    at_end = {"executeControl": "onEnd", "writeControl": "onEnd"}
    return reports | {"yPlus": {"type": "yPlus", "libs": ["fieldFunctionObjects"], **at_end}}


def _fields(air: Air, wind_b: Floats) -> dict[str, Entry]:
    velocity = tuple(air.speed * wind_b)
    k = 1.5 * (air.turbulence_intensity * air.speed) ** 2
    omega = k / (air.viscosity_ratio * air.viscosity)
    # Inside, the flow starts with high viscosity: ν_t is about V times a millimetre.
    start_k, start_omega = 8.3e-4 * air.speed**2, 30.0

    def field(dimensions: str, inside: Entry, far: Mapping[str, Entry], wall: Mapping[str, Entry]) -> Entry:
        return {
            "dimensions": dimensions,
            "internalField": f"uniform {_value(inside)}",
            "boundaryField": {FAR: far, "wall": wall},
        }

    def inlet(value: float) -> Entry:
        return {"type": "inletOutlet", "inletValue": f"uniform {value:.9g}", "value": f"uniform {value:.9g}"}

    free = {"type": "freestreamVelocity", "freestreamValue": f"uniform {_value(velocity)}"}
    pressure = {"type": "freestreamPressure", "freestreamValue": "uniform 0"}
    return {
        "U": field("[0 1 -1 0 0 0 0]", velocity, free, {"type": "noSlip"}),
        "p": field("[0 2 -2 0 0 0 0]", 0.0, pressure, {"type": "zeroGradient"}),
        "k": field("[0 2 -2 0 0 0 0]", start_k, inlet(k), {"type": "kqRWallFunction", "value": f"uniform {start_k}"}),
        "omega": field(
            "[0 0 -1 0 0 0 0]",
            start_omega,
            inlet(omega),
            {"type": "omegaWallFunction", "blended": "true", "value": f"uniform {start_omega}"},
        ),
        "nut": field(
            "[0 2 -1 0 0 0 0]",
            0.0,
            {"type": "calculated", "value": "uniform 0"},
            {"type": "nutUSpaldingWallFunction", "value": "uniform 0"},
        ),
    }


def _block(mesh: Mesh) -> Entry:
    w, n = mesh.half_width, mesh.cells_across
    corners = [(x, y, z) for z in (-w, w) for x, y in ((-w, -w), (w, -w), (w, w), (-w, w))]
    sides = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6), (1, 2, 6, 5), (0, 4, 7, 3)]
    return {
        "vertices": corners,
        "blocks": f"( hex (0 1 2 3 4 5 6 7) ({n} {n} {n}) simpleGrading (1 1 1) )",
        "boundary": f"( {FAR} {{ type patch; faces {_value(sides)}; }} )",
    }


def _snappy(surfaces: Mapping[str, Surface], mesh: Mesh) -> Entry:
    level = mesh.surface_level
    shells = [(shell.distance, shell.level) for shell in mesh.shells]
    # Outside every body and on no face of a cell.
    beside = tuple(0.9 * mesh.half_width * np.array([0.9871, 0.9773, 0.9637]))
    geometry = {"type": "triSurfaceMesh", "name": BODY, "regions": {name: {"name": name} for name in surfaces}}
    chosen = {
        "refinementSurfaces": {BODY: {"level": (level, level), "patchInfo": {"type": "wall"}}},
        "refinementRegions": {BODY: {"mode": "distance", "levels": shells}},
        "locationInMesh": beside,
    }
    fixed = FIXED["mesher"]
    castellated = fixed["castellatedMeshControls"] | chosen
    return {**fixed, "geometry": {f"{BODY}.stl": geometry}, "castellatedMeshControls": castellated}


def _write(folder: Path, path: str, entries: Mapping[str, Entry], kind: str = "dictionary") -> None:
    """Write one file in OpenFOAM's format."""
    header = {"version": 2.0, "format": "ascii", "class": kind, "object": Path(path).name}
    write_text(folder / path, "\n".join([*_lines({"FoamFile": header}), *_lines(entries)]) + "\n")


def _lines(entries: Mapping[str, Entry]) -> list[str]:
    lines = []
    for key, value in entries.items():
        if isinstance(value, Mapping):
            lines += [key, "{", *_lines(value), "}"]
        else:
            lines.append(f"{key} {_value(value)};")
    return lines


def _value(value: Entry) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"({' '.join(_value(item) for item in value)})"
    # Adding zero converts -0 to 0.
    return f"{value + 0.0:.9g}" if isinstance(value, float) else str(value)
