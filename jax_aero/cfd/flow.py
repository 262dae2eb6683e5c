"""Store the flow of one case for pictures: `jax-aero cfd flow NAME`, with NAME a file of `configs/cfd_flow/`.

Stores pressure on the robot, streamlines around it, and speed, pressure and turbulent viscosity in its plane of
symmetry, as in the paper's Fig. 3 c to f; `jax-aero figures cfd_flow cfd_meshes` draws them. Needs OpenFOAM and
PyVista, which reads its cases.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from jax_aero import rust
from jax_aero.aero.dataset import wind_direction
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.cfd import foam
from jax_aero.cfd.case import FAR
from jax_aero.cfd.geometry import robot_surfaces
from jax_aero.cfd.settings import Air, FlowConfig
from jax_aero.cfd.simulate import Unfit, make_mesh, solve
from jax_aero.data.import_cfd import POSTURES, known_postures
from jax_aero.results.study import Findings, Study

if TYPE_CHECKING:
    import pyvista

FIELDS = {
    "pressure": "pressure coefficient",
    "speed": "speed over the wind's",
    "viscosity": "turbulent over molecular viscosity",
}
BESIDE, EVERY, LENGTH = 0.02, 80, 1.2
"""Streamlines: distance from the surface [m], number of surface points per line, length before and behind [m]."""


def compute(_name: str, config: FlowConfig) -> Findings:
    """Simulate and sample the flow."""
    import pyvista  # noqa: F401 - reads the case; refused before it is computed

    foam.environment()
    known = known_postures()
    if config.posture not in known:
        raise Refused(f"`posture` is `{config.posture}`; expected one of {', '.join(known)}")
    surfaces = robot_surfaces(rust.Robot(ROBOT), known[config.posture])
    wind = wind_direction(config.pitch_deg, config.yaw_deg)
    settings = config.settings
    with tempfile.TemporaryDirectory(prefix="jax-aero-cfd-") as scratch:
        folder = Path(scratch)
        try:
            facts = make_mesh(surfaces, settings, folder)
        except (foam.Failed, Unfit) as reason:
            raise Refused(str(reason)) from None
        result = solve(surfaces, wind, settings, folder, facts)
        if result.reason:
            raise Refused(result.reason)
        cells, wall = read_case(folder, settings.solver.ranks, settings.air)
    plane = cells.slice("y", generate_triangles=True)
    surface = wall.compute_cell_sizes()
    data = to_dataset(wall.triangulate(), plane, streamlines(cells, wall))
    area, ratio = plane.compute_cell_sizes()["Area"], plane.cell_data["viscosity"]
    wake = plane.cell_data["speed"] < 0.5
    wake_area = float(area[wake].sum())
    summary: dict[str, Any] = {
        "drag [m2]": float(np.sum([*result.force_area_b.values()], axis=0) @ wind),
        "pressure share of the force": result.quality["pressure share of the force"],
        "turbulent over molecular viscosity, largest in the plane": float(ratio.max()),
        "wake in the plane, slower than half the wind [m2]": wake_area,
        "part of the wake in the plane where that is above 100": _part(area[wake], ratio[wake] > 100.0),
        "part of the surface where that is above 100": _part(surface["Area"], surface.cell_data["viscosity"] > 100.0),
        "cells": facts.cells,
    }
    data = data.assign_attrs(wind=wind, cells=facts.cells, edge=settings.mesh.finest)
    return Findings(config.title, data, summary, files=[ROBOT, POSTURES])


def _part(area: npt.NDArray[np.float64], chosen: npt.NDArray[np.bool_]) -> float:
    """Return the share of an area that the chosen cells have."""
    return float(area[chosen].sum() / area.sum())


def read_case(folder: Path, ranks: int, air: Air) -> tuple[pyvista.UnstructuredGrid, pyvista.PolyData]:
    """Return the cells of the air and the surface of the links at the last iteration, with `FIELDS` in both."""
    import pyvista

    path = folder / "case.foam"
    path.touch()
    reader = pyvista.POpenFOAMReader(path)
    reader.case_type = "decomposed" if ranks > 1 else "reconstructed"
    reader.cell_to_point_creation = False
    reader.set_active_time_value(reader.time_values[-1])
    reader.disable_patch_array(f"patch/{FAR}")
    blocks = reader.read()
    cells, wall = blocks["internalMesh"], pyvista.merge([*blocks["boundary"]])
    for data in (cells.cell_data, wall.cell_data):
        data["pressure"] = data["p"] / (0.5 * air.speed**2)  # the solver's pressure is divided by density
        data["speed"] = np.linalg.norm(data["U"], axis=1) / air.speed
        data["viscosity"] = data["nut"] / air.viscosity
    return cells.cell_data_to_point_data(pass_cell_data=True), wall.cell_data_to_point_data(pass_cell_data=True)


def streamlines(cells: pyvista.UnstructuredGrid, wall: pyvista.PolyData) -> pyvista.PolyData:
    """Return streamlines that pass close to the surface."""
    import pyvista

    outwards = wall.compute_normals(consistent_normals=False, flip_normals=True).point_data["Normals"]
    seeds = pyvista.PolyData((wall.points + BESIDE * outwards)[::EVERY])
    # With VTK's default, the nearest points, velocity would be interpolated inside the bodies too.
    lines: pyvista.PolyData = cells.streamlines_from_source(
        seeds, vectors="U", max_length=LENGTH, interpolator_type="cell"
    )
    return lines


def to_dataset(wall: pyvista.PolyData, plane: pyvista.PolyData, lines: pyvista.PolyData) -> xr.Dataset:
    """Return the points of triangles and lines with the `FIELDS` drawn there; base axes."""
    variables: dict[str, Any] = {}
    for name, part, fields in (("wall", wall, ["pressure"]), ("plane", plane, [*FIELDS]), ("line", lines, ["speed"])):
        point, single = f"{name}_point", "f4"  # sufficient for pictures
        variables[f"{name}_position"] = (point, "xyz"), part.points.astype(single), {"units": "m"}
        for field in fields:
            about = {"units": "1", "long_name": FIELDS[field]}
            variables[f"{name}_{field}"] = point, part.point_data[field].astype(single), about
    for name, part in (("wall", wall), ("plane", plane)):
        about = {"long_name": "points at the corners"}
        variables[f"{name}_triangle"] = (f"{name}_face", "corner"), part.regular_faces.astype("i4"), about
    order = {"long_name": "points of all streamlines, one after the other"}
    offset = {"long_name": "of every streamline in them, and the end of the last"}
    variables["line_order"] = "order", lines.line_connectivity.astype("i4"), order
    variables["line_offset"] = "offset", lines.line_offsets.astype("i4"), offset
    return xr.Dataset(variables, {"xyz": ["x", "y", "z"]})


STUDY = Study("cfd_flow", __doc__, FlowConfig, compute, ("flight30",), backend="openfoam")
main = STUDY.main
