"""Fig. 2 d, e: drag of the wind tunnel; no run is needed."""

from __future__ import annotations

from matplotlib.figure import Figure

from jax_aero.data import tables as measured
from jax_aero.data.tables import TUNNEL, Table
from jax_aero.figures import style
from jax_aero.figures.entry import Entry

SYMMETRIC = ("flight30", "flight50", "flight60")
COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.SKY, style.PURPLE, style.BLACK, style.GREY)
MARKERS = "osD^v<>p"


def draw(tables: Table) -> Figure:
    """Draw the drag area against sideslip at three speeds, and against the angle of attack for eight postures."""
    figure = style.figure(3.2)
    left, right = figure.subplots(1, 2)
    for (speed, curve), colour, marker in zip(measured.hovering_drag(tables).items(), COLOURS, MARKERS, strict=False):
        left.plot(
            list(curve), list(curve.values()), marker=marker, markersize=3.5, color=colour, label=f"{speed:.0f} m/s"
        )
    left.set_xlabel(r"sideslip $\beta$ [deg]")
    left.set_title("hovering, α = 90°")
    for table, colour, marker in zip(tables["flight"], COLOURS, MARKERS, strict=True):
        dash = "-" if table["posture"] in SYMMETRIC else "--"
        right.plot(
            table["alpha_deg"], table["cda"], dash, marker=marker, markersize=3.5, color=colour, label=table["posture"]
        )
    right.set_xlabel(r"angle of attack $\alpha$ [deg]")
    right.set_title("flight postures at 17 m/s, β = 0")
    for axes, mark in ((left, "d"), (right, "e")):
        axes.set_ylabel(r"$C_D A$ [m$^2$]")
        axes.legend()
        style.letter(axes, mark)
    return figure


FIGURES = {
    "fig2": Entry(draw, "Fig. 2 d, e: the wind tunnel's drag by speed and by posture; needs no run", tables=(TUNNEL,))
}
