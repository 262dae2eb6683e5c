"""Simulation of surfaces in winds: one mesh, then a solution for each wind, and acceptance of both.

    force   F̄ = mean of F over the last `window` iterations        drift   |F̄(second half) − F̄(first half)| / |F̄|
    oscillation   √(mean |F − F̄|²) / |F̄|          with F the total force on all links

A mesh is refused if it leaks, is disconnected or misses its level; a solution if it diverges, drifts or oscillates.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from jax_aero.aero.dataset import Floats
from jax_aero.cfd import case, foam
from jax_aero.cfd.geometry import Surface
from jax_aero.cfd.settings import Accept, Air, Mesh, Settings


class Result(msgspec.Struct, frozen=True):
    """Result for one wind: forces and couples of the links divided by dynamic pressure, or the reason for refusal."""

    reason: str = ""
    """Reason for refusal; empty if accepted."""
    force_area_b: dict[str, tuple[float, float, float]] = msgspec.field(default_factory=dict)
    """Force areas by link [m²], base axes."""
    couple_volume_b: dict[str, tuple[float, float, float]] = msgspec.field(default_factory=dict)
    """Couples by link about its centre, divided by dynamic pressure [m³], base axes."""
    quality: dict[str, float] = msgspec.field(default_factory=dict)
    """Reports of the mesher and the solver, by name with unit."""
    cp: dict[str, float] = msgspec.field(default_factory=dict)
    """Pressure coefficients by tap, mean over the window."""


class Unfit(Exception):
    """A mesh that is refused; the message states the reason."""


def simulate(
    surfaces: Mapping[str, Surface], winds: Iterable[Floats], settings: Settings, folder: Path
) -> Iterator[Result]:
    """Mesh once, and yield the result of every wind (3,), a unit vector of the air's motion, base axes."""
    try:
        facts = make_mesh(surfaces, settings, folder)
    except (foam.Failed, Unfit) as reason:
        yield from (Result(reason=str(reason)) for _ in winds)
        return
    for wind_b in winds:
        yield solve(surfaces, wind_b, settings, folder, facts)


def make_mesh(surfaces: Mapping[str, Surface], settings: Settings, folder: Path) -> foam.MeshFacts:
    """Mesh the air around the surfaces; raise `Unfit` if the mesh does not meet its settings."""
    case.write_mesh_case(folder, surfaces, settings.mesh)
    started = time.perf_counter()
    foam.run(["blockMesh"], folder)
    mesher = foam.run(["snappyHexMesh", "-overwrite"], folder)
    facts = foam.mesh_facts(mesher, foam.run(["checkMesh"], folder), time.perf_counter() - started)
    check_mesh(facts, area_of(surfaces), settings.mesh, settings.accept)
    return facts


def check_mesh(facts: foam.MeshFacts, area: float, mesh: Mesh, accept: Accept) -> None:
    """Raise `Unfit` unless a mesh around a surface of this area [m²] is connected and has its level everywhere."""
    if facts.regions != 1:
        raise Unfit(f"the mesh has {facts.regions} separate regions; expected 1: the air around the robot")
    wanted = area / mesh.finest**2
    if facts.finest_level != mesh.surface_level or facts.finest_cells < accept.finest_share * wanted:
        raise Unfit(
            f"the mesh has {facts.finest_cells} cells of level {facts.finest_level}, its finest; expected at least "
            f"{accept.finest_share * wanted:.0f} of level {mesh.surface_level}: choose a smaller `mesh.base`"
        )


def area_of(surfaces: Mapping[str, Surface]) -> float:
    """Return the area of all triangles [m²], including hidden parts."""
    corners = [surface.triangles for surface in surfaces.values()]
    a, b, c = np.moveaxis(np.concatenate(corners), 1, 0)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def solve(
    surfaces: Mapping[str, Surface],
    wind_b: Floats,
    settings: Settings,
    folder: Path,
    facts: foam.MeshFacts,
) -> Result:
    """Compute and judge the solution for one wind on an existing mesh."""
    for path in (*folder.glob("[0-9]*"), *folder.glob("processor*"), folder / "postProcessing"):
        shutil.rmtree(path, ignore_errors=True)
    case.write_wind_case(folder, wind_b, settings)
    solver, started = settings.solver, time.perf_counter()
    try:
        if solver.ranks > 1:
            foam.run(["decomposePar"], folder)
        if solver.upwind_iterations:
            case.write_schemes(folder, is_upwind=True)
            case.write_control(folder, end=solver.upwind_iterations, functions={})
            foam.run(["simpleFoam"], folder, solver.ranks)
        case.write_schemes(folder, is_upwind=False)
        for number in range(1 + solver.extensions):
            end = solver.iterations + number * solver.window
            functions = case.reports_of(surfaces, settings.air, solver, end)
            case.write_control(folder, end=end, functions=functions)
            said = foam.run(["simpleFoam"], folder, solver.ranks)
            y_plus_mean, y_plus_max = foam.read_y_plus(folder)
            quality = {
                "OpenFOAM": facts.release,
                "cells": float(facts.cells),
                "mesh seconds": round(facts.seconds, 1),
                "solve seconds": round(time.perf_counter() - started, 1),
                "largest non-orthogonality [deg]": facts.max_non_orthogonality,
                "largest skewness": facts.max_skewness,
                "y+ mean": y_plus_mean,
                "y+ largest": y_plus_max,
                "residual of p": foam.last_residual(said, "p"),
                "residual of Ux": foam.last_residual(said, "Ux"),
                "iterations": float(end),
                "averaging window": float(solver.window),
            }
            result = reduce(foam.read_histories(folder, surfaces), quality, settings)
            if not result.reason or not result.force_area_b:
                break
    except foam.Failed as reason:
        return Result(reason=f"the solver diverged: {reason}")
    return msgspec.structs.replace(result, cp=dict(read_cp(surfaces, settings.air, folder)))


def read_cp(surfaces: Mapping[str, Surface], air: Air, folder: Path) -> Iterator[tuple[str, float]]:
    """Yield every tap with its pressure coefficient `p / (½ V²)`, p kinematic."""
    for link, surface in surfaces.items():
        if surface.taps:
            yield from zip(surface.taps, (foam.read_taps(folder, link) / (0.5 * air.speed**2)).tolist(), strict=True)


def reduce(histories: Mapping[str, foam.History], quality: Mapping[str, float], settings: Settings) -> Result:
    """Average the histories of all links over the window and judge the total force."""
    pressure = 0.5 * settings.air.density * settings.air.speed**2
    total = np.sum([history.force for history in histories.values()], axis=0)
    iteration = next(iter(histories.values())).iteration
    late = iteration > iteration[-1] - settings.solver.window
    size, drift, oscillation = steadiness(total[late])
    figures = {**quality, "drift": drift, "oscillation": oscillation}
    figures["pressure share of the force"] = _pressure_share(histories, late)
    accept = settings.accept
    if not math.isfinite(size) or not math.isfinite(drift):
        return Result(reason="the solver diverged: the force is not finite")
    reason = ""
    if drift > accept.drift:
        reason = f"the force drifts by {drift:.2%} within the window; expected at most {accept.drift:.2%}"
    elif oscillation > accept.oscillation:
        reason = f"the force oscillates by {oscillation:.2%}; expected at most {accept.oscillation:.2%}"
    return Result(
        reason=reason,
        force_area_b={name: _mean(history.force[late] / pressure) for name, history in histories.items()},
        couple_volume_b={name: _mean(history.couple[late] / pressure) for name, history in histories.items()},
        quality=figures,
    )


def steadiness(total: Floats) -> tuple[float, float, float]:
    """Return magnitude of the mean [N], drift and oscillation of the total force (S, 3) within the window."""
    mean = total.mean(axis=0)
    size = float(np.linalg.norm(mean))
    half = len(total) // 2
    drift = np.linalg.norm(total[half:].mean(axis=0) - total[:half].mean(axis=0)) / size
    oscillation = np.sqrt(np.mean(np.sum((total - mean) ** 2, axis=1))) / size
    return size, float(drift), float(oscillation)


def _mean(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.mean(axis=0).tolist()
    return x, y, z


def _pressure_share(histories: Mapping[str, foam.History], late: Any) -> float:
    """Return the share of the pressure in the total force, along its direction."""
    total = np.sum([history.force[late].mean(axis=0) for history in histories.values()], axis=0)
    pressure = np.sum([history.pressure[late].mean(axis=0) for history in histories.values()], axis=0)
    return float(pressure @ total / (total @ total))
