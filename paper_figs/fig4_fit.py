"""Fig. 4 d and e: the axisymmetric model over the simulations it was fitted to, and the coefficients."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.entry import Entry

DRAG = r"$C_D A$ [m$^2$]"
NORMAL = r"$C_N A$ [m$^2$]"


def draw(study: xr.Dataset) -> Figure:
    """Draw the lower leg as in the paper; below it the head's misprint and the chest's sign."""
    figure = style.figure(5.6)
    grid = figure.subplots(2, 2)
    drag_of_leg, normal_of_leg, drag_of_head, normal_of_chest = grid.ravel()
    _drag(drag_of_leg, study, ["l_lower_leg", "r_lower_leg"], {"published": style.VERMILION, "refit": style.BLUE})
    _normal(normal_of_leg, study, ["l_lower_leg", "r_lower_leg"])
    _drag(
        drag_of_head,
        study,
        ["head"],
        {"published": style.VERMILION, "corrected": style.ORANGE, "refit": style.BLUE},
    )
    _normal(normal_of_chest, study, ["chest"])
    titles = ("lower leg: drag", "lower leg: normal force", "head: drag", "chest: normal force")
    for axes, mark, title in zip(grid.ravel(), "defg", titles, strict=True):
        axes.set_title(title, pad=28)
        axes.set_xlim(0.0, 180.0)
        axes.set_xticks(range(0, 181, 30))
        axes.set_xlabel(r"angle of attack $\alpha_l$ [deg]")
        style.legend_above(axes, columns=3)
        style.letter(axes, mark)
    return figure


def _drag(axes: Axes, study: xr.Dataset, links: list[str], variants: dict[str, str]) -> None:
    _points(axes, study, links, "drag_area", style.LIGHT, "CFD")
    alpha = np.linspace(0.0, np.pi, 181)
    c, s = np.cos(alpha), np.sin(alpha)
    for variant, colour in variants.items():
        w = study["coefficients"].sel(variant=variant, link=links[0]).values
        curve = w[0] + w[1] * c + w[2] * s**2 + w[3] * s**3 + w[4] * c**3
        dash = {"published": "--", "corrected": ":"}.get(variant, "-")
        # The printed curves are drawn on top, so that both are visible where they agree.
        order = 3 if variant == "refit" else 4
        axes.plot(np.degrees(alpha), curve, dash, color=colour, linewidth=1.5, label=variant, zorder=order)
    axes.set_ylabel(DRAG)


def _normal(axes: Axes, study: xr.Dataset, links: list[str]) -> None:
    _points(axes, study, links, "across_area", "#F3C9A5", "CFD, magnitude")
    _points(axes, study, links, "normal_area", style.LIGHT, "CFD, towards the axis")
    alpha = np.linspace(0.0, np.pi, 181)
    shape = np.sin(alpha) ** 2 * np.cos(alpha)
    w5 = study["coefficients"].sel(link=links[0], term="w5")
    published = float(w5.sel(variant="published"))
    axes.plot(np.degrees(alpha), published * shape, color=style.VERMILION, linewidth=1.5, label="published")
    axes.plot(
        np.degrees(alpha), np.abs(published * shape), ":", color=style.VERMILION, linewidth=1.5, label="its magnitude"
    )
    axes.plot(
        np.degrees(alpha),
        float(w5.sel(variant="refit")) * shape,
        color=style.BLUE,
        linewidth=1.5,
        label="refit, signed",
    )
    axes.set_ylabel(NORMAL)


def _points(axes: Axes, study: xr.Dataset, links: list[str], name: str, colour: str, label: str) -> None:
    chosen = study.sel(link=links)
    # Thousands of points, rasterised inside the PDF.
    axes.plot(
        chosen["angle_of_attack"].values.ravel(),
        chosen[name].values.ravel(),
        ".",
        color=colour,
        markersize=1.6,
        rasterized=True,
        label=label,
    )


FIGURES = {
    "fig4_fit": Entry(draw, "Fig. 4 d, e: the axisymmetric model over the CFD", "fit_aero", ("freestream",)),
}
