"""Pressures at taps on the robot: the wind tunnel, our flow and their difference, from ahead and from the side."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

SEEN = 0.1
"""Least cosine between the normal of a tap that is drawn and the direction to the viewer."""
VIEWS = {"from ahead": (0, 1, "robot's left"), "from the left": (1, 0, "backward")}
"""Axis towards the viewer, negative, axis to the right, and its name; axes x backward, y right, z up."""


def draw(study: xr.Dataset) -> Figure:
    """Draw the first case on the robot, and all cases by link."""
    figure = style.figure(7.6, width=5.2)
    grid = figure.subplot_mosaic("abc;def;ggg", height_ratios=(1.0, 1.0, 1.25))
    case = study.isel(case=0)
    for row, view in zip(("abc", "def"), VIEWS, strict=True):
        for mark, (what, values) in zip(row, fields(case).items(), strict=True):
            shown = _taps(grid[mark], case, values, view)
            grid[mark].set_title(what if row == "abc" else "")
            style.letter(grid[mark], mark)
        grid[row[0]].set_ylabel(f"{view}\nz [m]")
    figure.colorbar(
        shown, ax=[grid[mark] for mark in "abcdef"], label="pressure coefficient", extend="both", shrink=0.7
    )
    _by_link(grid["g"], study)
    style.letter(grid["g"], "g")
    wind = f"pitch {float(case['pitch']):.0f}°, yaw {float(case['yaw']):.0f}°"
    style.title(figure, f"a to f: {case['posture'].item()}, {wind}; g: {study.sizes['case']} cases")
    return figure


def fields(case: xr.Dataset) -> dict[str, xr.DataArray]:
    """Return what is drawn of a case."""
    return {"tunnel": case["cp_tunnel"], "our CFD": case["cp"], "CFD less tunnel": case["cp"] - case["cp_tunnel"]}


def _taps(axes: Axes, case: xr.Dataset, values: xr.DataArray, view: str) -> ScalarMappable:
    towards, right, label = VIEWS[view]
    sign = -1.0 if towards == 0 else 1.0
    place, normal = case["position"].values, case["normal"].values
    axes.scatter(sign * place[:, right], place[:, 2], s=3.0, color=style.LIGHT)
    seen = np.isfinite(values.values) & (-normal[:, towards] > SEEN)
    look: dict[str, Any] = {
        "s": 26.0,
        "cmap": "RdBu_r",
        "vmin": -1.5,
        "vmax": 1.5,
        "edgecolors": style.GREY,
        "linewidths": 0.3,
    }
    shown = axes.scatter(sign * place[seen, right], place[seen, 2], c=values.values[seen], **look)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=False)
    axes.set_xlabel(f"{label} [m]")
    return shown


def _by_link(axes: Axes, study: xr.Dataset) -> None:
    links = study["link"].values
    names = list(dict.fromkeys(links.tolist()))
    looks = zip(style.GROUP_COLOURS, "o^sDvP*X", names, strict=False)
    for colour, marker, link in looks:
        part = study.isel(tap=links == link)
        tunnel, flow = part["cp_tunnel"].values.ravel(), part["cp"].values.ravel()
        look: dict[str, Any] = {"linestyle": "", "color": colour, "markersize": 2.0, "alpha": 0.6}
        axes.plot(tunnel, flow, marker, label=link.replace("_", " "), **look)
    axes.axline((0.0, 0.0), slope=1.0, color=style.BLACK, linewidth=0.8)
    axes.set(xlabel="pressure coefficient, tunnel", ylabel="our CFD", xlim=(-2.6, 1.2), ylim=(-2.6, 1.2))
    axes.set_aspect("equal")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), markerscale=2.5)


FIGURES = {
    "cfd_taps": Entry(
        draw, "Suppl. Fig. 2: pressures at the taps, wind tunnel and our flow", "cfd_taps", ("mk1_taps",)
    ),
}
