"""Rendered pictures: Fig. 5 a and the postures; and a drawing of the set-up in the wind tunnel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Circle, FancyArrow, Polygon, Rectangle

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

COLUMNS = 8
WIDTH, HEIGHT = 4.0, 3.84
"""Width and height of the test section [m]. Source: paper, Methods."""
CENTRE = 1.9
"""Height of the robot's base above the ground in the drawing [m]; the real one is not public."""
LEAN, TURN = 45.0, 40.0
"""Angle of attack and sideslip in the drawing [deg]."""

REACH = 0.85
"""Length of the lines between which an angle is drawn [m]."""

Array = npt.NDArray[np.float64]


def flight(study: xr.Dataset) -> Figure:
    """Show the flight: forces and wind as arrows, thrusts as cones, set-point of the CoM as a cross."""
    picture = study["flight"].values
    figure = style.figure(4.8 * picture.shape[0] / picture.shape[1], width=4.8)
    axes = figure.subplots()
    axes.imshow(picture)
    axes.set_axis_off()
    axes.set_title(str(study["flight"].attrs["long_name"]))
    keys = {
        "wind": style.SKY,
        "aerodynamic force on a link": style.BLUE,
        "thrust": style.ORANGE,
        "set-point of the CoM": style.GREEN,
    }
    handles = [Line2D([], [], color=colour, linewidth=4, label=label) for label, colour in keys.items()]
    figure.legend(handles=handles, loc="outside lower left", ncols=len(keys), columnspacing=1.0)
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
    """Draw the robot on pylon and balance: from its left, upright and pitched; from above, ahead and yawed (pale)."""
    spans = np.stack([study["link_start"].values, study["link_end"].values], axis=1)
    widths = study["link_diameter"].values
    figure = style.figure(4.0)
    side, top = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    up, base = np.array([0.0, 0.0, CENTRE]), np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    for axes, centre, plane, axis, turned, marked in (
        (side, up, (0, 2), base[0], (LEAN, 0.0), "90° − α"),
        (top, np.zeros(3), (0, 1), base[1], (90.0, TURN), "β"),
    ):
        ways = []
        for angles, colour in ((turned, style.LIGHT), ((90.0, 0.0), style.BLUE)):
            _robot(axes, _turn_points(spans, *angles) + centre, widths, plane, colour)
            ways.append(_turn_points(axis, *angles)[list(plane)])
            end = centre[list(plane)] + REACH * ways[-1]
            axes.plot(*np.transpose([centre[list(plane)], end]), color=style.BLACK, linewidth=0.7, linestyle="--")
        _angle(axes, centre[list(plane)], ways, marked)
    _support(side)
    top.add_patch(Circle((0.0, 0.0), 0.9, fill=False, linestyle=":", color=style.GREY))
    top.text(0.0, -1.05, "turntable", ha="center", fontsize=8)
    _scene(side, (-1.5, 1.75), (-0.1, 3.1), ("x", "z"), f"from the left: pitched by {90.0 - LEAN:g}° (pale)")
    _scene(top, (-1.5, 1.5), (-1.6, 1.6), ("x", "y"), f"from above: yawed by {TURN:g}° (pale)")
    style.letters((side, top))
    style.footnote(figure, f"test section: {WIDTH:g} m wide, {HEIGHT:g} m high")
    return figure


def _angle(axes: Axes, centre: Array, ways: Sequence[Array], text: str) -> None:
    """Draw the angle between two directions, with its name."""
    begin, end = sorted(np.degrees(np.arctan2(way[1], way[0])) % 360.0 for way in ways)
    axes.add_patch(Arc((centre[0], centre[1]), 1.8 * REACH, 1.8 * REACH, theta1=begin, theta2=end, color=style.BLACK))
    middle = np.radians(0.5 * (begin + end))
    x, y = centre + 1.05 * REACH * np.array([np.cos(middle), np.sin(middle)])
    axes.text(x, y, text, ha="center", va="center")


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
        axes.annotate(text, point, at, fontsize=8, va="center", arrowprops={"arrowstyle": "-", "lw": 0.6})


def _scene(
    axes: Axes, across: tuple[float, float], up: tuple[float, float], names: tuple[str, str], title: str
) -> None:
    """Draw wind and axes, and set the limits."""
    left, low, high = across[0], *up
    for shift in (-0.25, 0.0, 0.25):
        axes.add_patch(FancyArrow(left, high - 0.7 + shift, 0.4, 0.0, width=0.02, head_width=0.1, color=style.SKY))
    axes.text(left, high - 0.3, "wind", color=style.BLUE)
    origin = np.array([left + 0.1, low + 0.2])
    for name, way in zip(names, np.eye(2), strict=True):
        axes.add_patch(FancyArrow(*origin, *(0.35 * way), width=0.015, head_width=0.09, color=style.VERMILION))
        x, y = origin + 0.58 * way
        axes.text(x, y, name, ha="center", va="center")
    axes.set(xlim=across, ylim=up, aspect="equal", title=title)
    axes.set_axis_off()


FIGURES = {
    "fig2_setup": Entry(setup, "Fig. 2 a-c as a drawing: robot, pylon, balance, axes", "pictures", ("paper",)),
    "fig5a": Entry(flight, "Fig. 5 a: the flight, rendered", "pictures", ("paper",)),
    "postures": Entry(postures, "Suppl. Fig. 8, 9: the postures, rendered", "pictures", ("paper",)),
}
