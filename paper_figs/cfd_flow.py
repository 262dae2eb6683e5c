"""Flow around the robot from the open solver: pressure on the surface, streamlines, and fields in a plane."""

from __future__ import annotations

from ctypes.util import find_library
from string import ascii_lowercase
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from jax_aero.base.terminal import missing_package
from jax_aero.figures import style
from jax_aero.figures.entry import Entry
from jax_aero.figures.runs import MissingRun

VIEW = 0.9
"""Half the height of the pictures in the plane [m]."""
SCALES = {"pressure": (-1.0, 1.0, "RdBu_r"), "speed": (0.0, 1.3, "viridis"), "viscosity": (0.0, 1000.0, "magma")}
"""Lowest and highest value, and colour map."""
PIXELS = (2160, 900)
TUBE = 0.0025
"""Radius of a streamline [m]."""


def draw(study: xr.Dataset) -> Figure:
    """Draw one case, with the wind from the left."""
    figure = style.figure(6.0)
    grid = figure.subplot_mosaic("AAA;bcd", height_ratios=(1.2, 1.0))
    grid["A"].imshow(picture(study))
    grid["A"].set_axis_off()
    grid["A"].set_title("surface in the colours of b, streamlines in those of c")
    style.letter(grid["A"], "a")
    turn = _upright_rotation(study.attrs["wind"])
    for mark, field in zip("bcd", SCALES, strict=True):
        shown = _plane(grid[mark], study, turn, field)
        label = study[f"plane_{field}"].attrs["long_name"]
        figure.colorbar(shown, ax=grid[mark], location="bottom", label=label, extend="both")
        style.letter(grid[mark], mark)
    grid["b"].set_ylabel("across the wind [m]")
    return figure


def meshes(*studies: xr.Dataset) -> Figure:
    """Draw the speed in the plane of symmetry on several meshes, with the wind from the left."""
    figure = style.figure(3.4)
    (row,) = figure.subplots(1, len(studies), sharey=True, squeeze=False)
    for mark, axes, study in zip(ascii_lowercase, row, studies, strict=False):
        shown = _plane(axes, study, _upright_rotation(study.attrs["wind"]), "speed")
        axes.set_title(f"{1e3 * study.attrs['edge']:.1f} mm, {1e-3 * study.attrs['cells']:.0f} thousand cells")
        style.letter(axes, mark)
    row[0].set_ylabel("across the wind [m]")
    label = studies[0]["plane_speed"].attrs["long_name"]
    figure.colorbar(shown, ax=row, location="bottom", label=label, extend="both", shrink=0.5)
    return figure


def _upright_rotation(wind: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (2, 2) of the plane of symmetry, (x, z) of the base, that turns the wind to the right."""
    along = np.array([wind[0], wind[2]]) / np.hypot(wind[0], wind[2])
    return np.array([along, [-along[1], along[0]]])


def _plane(axes: Axes, study: xr.Dataset, turn: NDArray[np.float64], field: str) -> ScalarMappable:
    """Draw one field in the plane of symmetry, with the cut parts of the robot in grey."""
    x, y = turn @ study["plane_position"].values[:, [0, 2]].T
    low, high, colours = SCALES[field]
    triangles = Triangulation(x, y, study["plane_triangle"].values)
    values = study[f"plane_{field}"].values
    shown = axes.tripcolor(triangles, values, shading="gouraud", cmap=colours, vmin=low, vmax=high, rasterized=True)
    axes.set(facecolor=style.GREY, aspect="equal", xlim=(-0.8 * VIEW, 1.2 * VIEW), ylim=(-VIEW, VIEW))
    axes.set_xlabel("along the wind [m]")
    axes.grid(visible=False)
    return shown


def picture(study: xr.Dataset) -> NDArray[np.uint8]:
    """Render the surface, coloured by pressure, and streamlines, coloured by speed, from the robot's front left."""
    view = plotter()
    import pyvista

    wall = pyvista.PolyData.from_regular_faces(study["wall_position"].values, study["wall_triangle"].values)
    lines = pyvista.PolyData(study["line_position"].values)
    lines.lines = pyvista.CellArray.from_arrays(study["line_offset"].values, study["line_order"].values)
    wall["pressure"], lines["speed"] = study["wall_pressure"].values, study["line_speed"].values
    wind, left = study.attrs["wind"], np.array([0.0, -1.0, 0.0])
    up = np.cross(left, wind)
    for part, field, edges in ((wall, "pressure", True), (lines.tube(radius=TUBE), "speed", False)):
        low, high, colours = SCALES[field]
        look = {"smooth_shading": True, "split_sharp_edges": edges, "show_scalar_bar": False, "ambient": 0.25}
        view.add_mesh(part, scalars=field, clim=(low, high), cmap=colours, **look)
    view.enable_anti_aliasing("ssaa")
    middle = 0.2 * wind - 0.03 * up
    view.camera_position = [middle + 3.0 * (left - 0.35 * wind + 0.2 * up), middle, up]
    view.camera.view_angle = 18.0
    with pyvista.vtk_verbosity("error"):
        shown: NDArray[np.uint8] = view.screenshot(return_img=True)
    view.close()
    return shown


def plotter() -> Any:
    """Return an off-screen plotter; refuse if something is missing."""
    try:
        import pyvista
    except ModuleNotFoundError as missing:
        raise MissingRun(missing_package("it", missing, "flow")) from None
    with pyvista.vtk_verbosity("error"):  # VTK warns of every unavailable kind of window
        window = pyvista.Plotter(off_screen=True, window_size=PIXELS, lighting="three lights")
    # The last kind that VTK tries; without its library it would end the process.
    if window.render_window.GetClassName() == "vtkOSOpenGLRenderWindow" and find_library("OSMesa") is None:
        raise MissingRun(
            "there is no off-screen OpenGL; install EGL or OSMesa, e.g. the Debian packages `libegl1 libgl1-mesa-dri` "
            "or `libosmesa6`"
        )
    return window


FIGURES = {
    "cfd_flow": Entry(
        draw,
        "Fig. 3 c-f of our own flow: surface pressure, streamlines, plane of symmetry",
        "cfd_flow",
        ("flight30",),
    ),
    "cfd_meshes": Entry(
        meshes,
        "Suppl. Fig. 5: speed around the robot on three meshes of ours",
        "cfd_flow",
        ("flight30_coarse", "flight30", "flight30_fine"),
    ),
}
