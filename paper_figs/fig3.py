"""Fig. 3 a, b: CFD beside the wind tunnel; no run is needed."""

from __future__ import annotations

from matplotlib.figure import Figure

from jax_aero.data import tables as measured
from jax_aero.data.tables import CFD, EPSILON, FINEST, OMEGA, TUNNEL, Table
from jax_aero.figures import style
from jax_aero.figures.entry import Entry

TURBULENCE = {OMEGA: (style.BLUE, "s", "SST k-ω"), EPSILON: (style.VERMILION, "^", "realizable k-ε")}
"""Colour, marker and name in a figure."""


def draw(tables: Table, simulations: Table) -> Figure:
    """Draw drag and lift area of flight30 from tunnel and from CFD with two turbulence models."""
    runs = simulations["run"]
    figure = style.figure(2.9)
    pair = figure.subplots(1, 2)
    for axes, key, mark in zip(pair, ("cda", "cla"), "ab", strict=True):
        record = measured.flight(tables, "flight30")
        axes.plot(record["alpha_deg"], record[key], "o-", color=style.BLACK, markersize=4, label="wind tunnel")
        for turbulence, (colour, marker, name) in TURBULENCE.items():
            run = measured.run_of(runs, FINEST, turbulence)
            axes.plot(run["alpha_deg"], run[key], marker + "--", color=colour, markersize=4, label=f"CFD, {name}")
        axes.set_xlabel(r"angle of attack $\alpha$ [deg]")
        axes.set_ylabel(rf"$C_{'D' if key == 'cda' else 'L'} A$ [m$^2$]")
        axes.legend()
        style.letter(axes, mark)
    return figure


FIGURES = {
    "fig3": Entry(draw, "Fig. 3 a, b: CFD beside the wind tunnel; needs no run", tables=(TUNNEL, CFD)),
}
