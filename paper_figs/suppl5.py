"""Suppl. Fig. 5: mesh study; no run is needed."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.data import tables as measured
from jax_aero.data.tables import CFD, OMEGA, TUNNEL, Table
from jax_aero.figures import style
from jax_aero.figures.entry import Entry
from paper_figs.fig3 import TURBULENCE

COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.SKY)


def draw(tables: Table, simulations: Table) -> Figure:
    """Draw the drag of five meshes beside the tunnel, and their error against their size."""
    runs = simulations["run"]
    record = measured.flight(tables, "flight30")
    figure = style.figure(2.8)
    grid = figure.subplots(1, 3)
    for axes, key, mark in zip(grid, ("cda", "cla"), "ab", strict=False):
        axes.plot(record["alpha_deg"], record[key], "o-", color=style.BLACK, markersize=4, label="wind tunnel")
        for name, colour, marker in zip(measured.meshes(runs), COLOURS, "sD^v<", strict=False):
            run = measured.run_of(runs, name, OMEGA)
            axes.plot(run["alpha_deg"], run[key], marker + "--", color=colour, markersize=3, linewidth=0.8, label=name)
        axes.set_xlabel(r"$\alpha$ [deg]")
        axes.set_ylabel(rf"$C_{'D' if key == 'cda' else 'L'} A$ [m$^2$]")
        style.letter(axes, mark)
    grid[0].legend()
    _mesh_errors(grid[2], record, runs)
    style.letter(grid[2], "c")
    return figure


def _mesh_errors(axes: Axes, record: Table, runs: Sequence[Table]) -> None:
    for turbulence, (colour, marker, name) in TURBULENCE.items():
        chosen = [measured.run_of(runs, mesh_name, turbulence) for mesh_name in measured.meshes(runs)]
        sizes, errors = [run["elements"] for run in chosen], [100 * measured.drag_error(record, run) for run in chosen]
        axes.plot(sizes, errors, marker + "-", color=colour, markersize=4, label=name)
    axes.set_xscale("log")
    axes.set_ylim(0.0, 11.5)
    axes.set_xlabel("mesh elements")
    axes.set_ylabel("rms drag error [% of mean]")
    axes.legend(loc="upper left")


FIGURES = {
    "supp_mesh": Entry(draw, "Suppl. Fig. 5: mesh study; needs no run", tables=(TUNNEL, CFD)),
}
