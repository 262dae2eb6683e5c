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

from experiments.cfd.foam import TAPS
from experiments.cfd.geometry import Surface, write_stl
from experiments.cfd.settings import Air, Mesh, Settings, Solver
from jax_aero.aero.dataset import Floats
from jax_aero.base.files import write_text

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


def write_mesh_case(folder: Path, surfaces: Mapping[str, Surface], mesh: Mesh) -> None:
    """Write the input of `blockMesh` and `snappyHexMesh`."""
    write_stl(surfaces, folder / "constant" / "triSurface" / f"{BODY}.stl")
    write_control(folder, end=1, functions={})
    write_schemes(folder, is_upwind=True)
    _write(folder, "system/fvSolution", SOLUTION)
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
    control = {
        "application": "simpleFoam",
        "startFrom": "latestTime",
        "startTime": 0,
        "stopAt": "endTime",
        "endTime": end,
        "deltaT": 1,
        "writeControl": "timeStep",
        "writeInterval": end,
        "purgeWrite": 1,
        "writeFormat": "binary",
        "runTimeModifiable": "false",
        "functions": functions,
    }
    _write(folder, "system/controlDict", control)


def write_schemes(folder: Path, *, is_upwind: bool) -> None:
    """Write the discretisation, with first- or second-order convection of the velocity."""
    convection = "bounded Gauss upwind" if is_upwind else "bounded Gauss linearUpwindV grad(U)"
    schemes = {
        "ddtSchemes": {"default": "steadyState"},
        "gradSchemes": {"default": "cellLimited Gauss linear 1"},
        "divSchemes": {
            "default": "none",
            "div(phi,U)": convection,
            "div(phi,k)": "bounded Gauss upwind",
            "div(phi,omega)": "bounded Gauss upwind",
            "div((nuEff*dev2(T(grad(U)))))": "Gauss linear",
        },
        "laplacianSchemes": {"default": "Gauss linear limited 0.5"},
        "interpolationSchemes": {"default": "linear"},
        "snGradSchemes": {"default": "limited 0.5"},
        "wallDist": {"method": "meshWave"},
    }
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
    found: dict[str, Entry] = {
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
    found |= {
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
    return found | {"yPlus": {"type": "yPlus", "libs": ["fieldFunctionObjects"], **at_end}}


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
    return {
        "castellatedMesh": "true",
        "snap": "true",
        "addLayers": "false",
        "geometry": {f"{BODY}.stl": geometry},
        "castellatedMeshControls": {
            "maxLocalCells": 20_000_000,
            "maxGlobalCells": 20_000_000,
            "minRefinementCells": 0,
            "nCellsBetweenLevels": 2,
            "features": "()",
            "refinementSurfaces": {BODY: {"level": (level, level), "patchInfo": {"type": "wall"}}},
            "resolveFeatureAngle": 30,
            "refinementRegions": {BODY: {"mode": "distance", "levels": shells}},
            "locationInMesh": beside,
            "allowFreeStandingZoneFaces": "false",
        },
        "snapControls": {
            "nSmoothPatch": 3,
            "tolerance": 2.0,
            "nSolveIter": 30,
            "nRelaxIter": 5,
            "nFeatureSnapIter": 10,
            "implicitFeatureSnap": "true",
            "explicitFeatureSnap": "false",
            "multiRegionFeatureSnap": "false",
        },
        "addLayersControls": LAYERS,
        "meshQualityControls": QUALITY,
        "mergeTolerance": 1e-6,
    }


LAYERS: Entry = {
    "relativeSizes": "true",
    "layers": {},
    "expansionRatio": 1.2,
    "finalLayerThickness": 0.5,
    "minThickness": 0.1,
    "nGrow": 0,
    "featureAngle": 60,
    "nRelaxIter": 3,
    "nSmoothSurfaceNormals": 1,
    "nSmoothNormals": 3,
    "nSmoothThickness": 10,
    "maxFaceThicknessRatio": 0.5,
    "maxThicknessToMedialRatio": 0.3,
    "minMedianAxisAngle": 90,
    "nBufferCellsNoExtrude": 0,
    "nLayerIter": 50,
}
"""Parameters of layers, which the mesher requires even without layers."""

QUALITY: Entry = {
    "maxNonOrtho": 65,
    "maxBoundarySkewness": 20,
    "maxInternalSkewness": 4,
    "maxConcave": 80,
    "minVol": 1e-13,
    "minTetQuality": 1e-15,
    "minArea": -1,
    "minTwist": 0.02,
    "minDeterminant": 0.001,
    "minFaceWeight": 0.05,
    "minVolRatio": 0.01,
    "minTriangleTwist": -1,
    "nSmoothScale": 4,
    "errorReduction": 0.75,
}
"""Mesh quality limits from OpenFOAM's example cases."""

_SMOOTH: Entry = {"solver": "smoothSolver", "smoother": "symGaussSeidel", "tolerance": 1e-9, "relTol": 0.1}
SOLUTION: Entry = {
    "solvers": {
        "p": {"solver": "GAMG", "smoother": "GaussSeidel", "tolerance": 1e-8, "relTol": 0.05},
        '"(U|k|omega)"': _SMOOTH,
    },
    "SIMPLE": {"consistent": "yes", "nNonOrthogonalCorrectors": 0},
    "relaxationFactors": {"fields": {"p": 1}, "equations": {"U": 0.85, '"(k|omega)"': 0.7}},
    "cache": dict.fromkeys(("grad(U)", "grad(p)", "grad(k)", "grad(omega)"), ""),
}
"""SIMPLEC; caching gradients until their field changes saves 40 % of the time without changing a bit."""


def _write(folder: Path, path: str, entries: Mapping[str, Entry], kind: str = "dictionary") -> None:
    """Write one file in OpenFOAM's format."""
    header = {"version": 2.0, "format": "ascii", "class": kind, "object": Path(path).name}
    write_text(folder / path, "\n".join([*_lines({"FoamFile": header}), *_lines(entries)]) + "\n")


def _lines(entries: Mapping[str, Entry]) -> list[str]:
    found = []
    for key, value in entries.items():
        if isinstance(value, Mapping):
            found += [key, "{", *_lines(value), "}"]
        else:
            found.append(f"{key} {_value(value)};")
    return found


def _value(value: Entry) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"({' '.join(_value(item) for item in value)})"
    # Adding zero converts -0 to 0.
    return f"{value + 0.0:.9g}" if isinstance(value, float) else str(value)
