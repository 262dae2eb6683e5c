"""Rendered pictures: Fig. 5 a and the postures; and a drawing of the set-up in the wind tunnel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrow, Polygon, Rectangle

from paper_figs import style
from paper_figs.entry import Entry

COLUMNS = 8
WIDTH, HEIGHT = 4.0, 3.84
"""Width and height of the test section [m]. Source: paper, Methods."""
CENTRE = 1.9
"""Height of the robot's base above the ground in the drawing [m]; the real one is not public."""
LEAN, TURN = 45.0, 40.0
"""Angle of attack and sideslip in the drawing [deg]."""

Array = npt.NDArray[np.float64]


def flight(study: xr.Dataset) -> Figure:
    """Show the flight: forces and wind as arrows, exhausts as cones, set-point of the CoM as a cross."""
    picture = study["flight"].values
    figure = style.figure(4.8 * picture.shape[0] / picture.shape[1], width=4.8)
    axes = figure.subplots()
    axes.imshow(picture)
    axes.set_axis_off()
    axes.set_title(str(study["flight"].attrs["long_name"]))
    return figure


def postures(study: xr.Dataset) -> Figure:
    """Show every posture with its name."""
    labels = study["posture"].values.tolist()
    rows = -(-len(labels) // COLUMNS)
    figure = style.figure(1.45 * rows)
    grid = figure.subplots(rows, COLUMNS)
    for axes in grid.ravel():
        axes.set_axis_off()
    for axes, label in zip(grid.ravel(), labels, strict=False):
        axes.imshow(study["posture_picture"].sel(posture=label).values)
        axes.set_title(label, fontsize=7, loc="center")
    return figure


def setup(study: xr.Dataset) -> Figure:
    """Draw the robot on pylon and balance in the test section: from its left with α, from above with β."""
    spans = np.stack([study["link_start"].values, study["link_end"].values], axis=1)
    widths = study["link_diameter"].values
    figure = style.figure(3.7)
    side, top = figure.subplots(1, 2)
    for lean, colour in ((LEAN, style.LIGHT), (90.0, style.BLUE)):
        _robot(side, _turn_points(spans, lean, 0.0) + np.array([0.0, 0.0, CENTRE]), widths, (0, 2), colour)
    _support(side)
    side.add_patch(Arc((0.0, CENTRE), 1.5, 1.5, theta1=90.0, theta2=180.0 - LEAN, color=style.BLACK))
    side.text(-0.42, CENTRE + 0.83, "90° − α", ha="center", fontsize=7.5)
    for turn, colour in ((TURN, style.LIGHT), (0.0, style.BLUE)):
        _robot(top, _turn_points(spans, 90.0, turn), widths, (0, 1), colour)
    top.add_patch(Arc((0.0, 0.0), 1.3, 1.3, theta1=180.0, theta2=180.0 + TURN, color=style.BLACK))
    top.text(-0.85, -0.3, "β", ha="center", fontsize=7.5)
    top.add_patch(Circle((0.0, 0.0), 0.9, fill=False, linestyle=":", color=style.GREY))
    top.text(0.0, 0.95, "turntable", ha="center", fontsize=7)
    _section(side, (-2.2, 0.0), HEIGHT, f"{HEIGHT:g} m high", ("x", "z"), "from its left")
    _section(top, (-2.2, -0.5 * WIDTH), WIDTH, f"{WIDTH:g} m wide", ("x", "y"), "from above")
    style.letters((side, top))
    return figure


def _turn_points(spans: Array, lean_deg: float, turn_deg: float) -> Array:
    """Rotate points from base to tunnel axes, about y by α − 90°, then about z by β; the wind blows along +x."""
    pitch, yaw = np.radians(lean_deg - 90.0), np.radians(turn_deg)
    about_y = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    turned: Array = spans @ (about_z @ about_y).T
    return turned


def _robot(axes: Axes, spans: Array, widths: Array, plane: tuple[int, int], colour: str) -> None:
    for (start, end), width in zip(spans[:, :, plane], widths, strict=True):
        along = end - start
        length = float(np.linalg.norm(along))
        if length > 1e-3:
            across = 0.5 * width * np.array([-along[1], along[0]]) / length
            corners = [start + across, end + across, end - across, start - across]
            axes.add_patch(Polygon(corners, facecolor=colour, edgecolor=style.BLACK, linewidth=0.5, alpha=0.8))
        for point in (start, end):
            if length <= 0.5 * width:
                axes.add_patch(Circle(point, 0.5 * width, facecolor=colour, edgecolor=style.BLACK, linewidth=0.5))


def _support(axes: Axes) -> None:
    axes.add_patch(Rectangle((0.42, 0.0), 0.16, 1.45, color=style.GREY))
    axes.add_patch(Rectangle((0.4, 1.45), 0.2, 0.22, color=style.ORANGE))
    axes.plot([0.5, 0.08], [1.67, CENTRE], color=style.BLACK, linewidth=2.5)
    axes.plot([-0.5, 0.9], [0.0, 0.0], color=style.BLACK, linewidth=4.0, solid_capstyle="butt")
    for text, point, at in (
        ("pylon, pitches", (0.58, 0.7), (0.95, 0.7)),
        ("balance, 6 axes", (0.6, 1.56), (0.95, 1.5)),
        ("strut", (0.3, 1.78), (0.95, 1.9)),
        ("turntable, yaws", (0.8, 0.02), (0.95, 0.3)),
    ):
        axes.annotate(text, point, at, fontsize=7, va="center", arrowprops={"arrowstyle": "-", "lw": 0.6})


def _section(
    axes: Axes, corner: tuple[float, float], across: float, size: str, names: tuple[str, str], title: str
) -> None:
    axes.add_patch(Rectangle(corner, 4.6, across, fill=False, color=style.BLACK))
    left, low = corner
    axes.text(left + 0.1, low + across - 0.22, size, fontsize=7)
    middle = low + 0.62 * across
    for shift in (-0.5, 0.0, 0.5):
        axes.add_patch(FancyArrow(left + 0.1, middle + shift, 0.45, 0.0, width=0.02, head_width=0.1, color=style.SKY))
    axes.text(left + 0.1, middle + 0.65, "air", fontsize=7, color=style.BLUE)
    origin = (left + 0.3, low + 0.25)
    for name, way in zip(names, ((0.5, 0.0), (0.0, 0.5)), strict=True):
        axes.add_patch(FancyArrow(*origin, *way, width=0.015, head_width=0.09, color=style.VERMILION))
        axes.text(origin[0] + 1.4 * way[0], origin[1] + 1.35 * way[1], name, fontsize=7.5, ha="center", va="center")
    axes.set(xlim=(left - 0.1, left + 4.7), ylim=(low - 0.1, low + across + 0.1), aspect="equal", title=title)
    axes.set_axis_off()


FIGURES = {
    "fig2_setup": Entry(setup, "Fig. 2 a-c as a drawing: robot, pylon, balance, axes", "pictures", ("paper",)),
    "fig5a": Entry(flight, "Fig. 5 a: the flight, rendered", "pictures", ("paper",)),
    "postures": Entry(postures, "Suppl. Fig. 8, 9: the postures, rendered", "pictures", ("paper",)),
}
