"""Figures 2d, 2e, 3a and 3b and the mesh study, from the tables of `configs/tables`; no run is needed."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jax_aero.base.places import CONFIGS
from paper_figs import style

TABLES = CONFIGS / "tables"
TUNNEL, CFD = "wind_tunnel.toml", "cfd_tunnel.toml"

FINEST = "953C"
OMEGA, EPSILON = "SST k-omega", "realizable k-epsilon"
TURBULENCE = {OMEGA: (style.BLUE, "s", "SST k-ω"), EPSILON: (style.VERMILION, "^", "realizable k-ε")}
"""Colour, marker and name in a figure."""
SYMMETRIC = ("flight30", "flight50", "flight60")
COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.ORANGE, style.SKY, style.PURPLE, style.BLACK, style.GREY)
MARKERS = "osD^v<>p"

Array = npt.NDArray[np.float64]
Table = Mapping[str, Any]


def read(name: str) -> dict[str, Any]:
    """Read a typed table."""
    return tomllib.loads((TABLES / name).read_text(encoding="utf-8"))


def hashes(*names: str) -> dict[str, str]:
    """Return the digest of each table, which is stored in the figure."""
    return {f"tables/{name}": hashlib.sha256((TABLES / name).read_bytes()).hexdigest() for name in names}


def fig2(tables: Table) -> Figure:
    """Draw the drag area against sideslip at three speeds, and against the angle of attack for eight postures."""
    figure = style.figure(3.2)
    left, right = figure.subplots(1, 2)
    for (speed, curve), colour, marker in zip(hovering_drag(tables).items(), COLOURS, MARKERS, strict=False):
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


def fig3(tables: Table, simulations: Table) -> Figure:
    """Draw drag and lift area of flight30 from tunnel and from CFD with two turbulence models."""
    runs = simulations["run"]
    figure = style.figure(2.9)
    pair = figure.subplots(1, 2)
    for axes, key, mark in zip(pair, ("cda", "cla"), "ab", strict=True):
        record = flight(tables, "flight30")
        axes.plot(record["alpha_deg"], record[key], "o-", color=style.BLACK, markersize=4, label="wind tunnel")
        for turbulence, (colour, marker, name) in TURBULENCE.items():
            run = run_of(runs, FINEST, turbulence)
            axes.plot(run["alpha_deg"], run[key], marker + "--", color=colour, markersize=4, label=f"CFD, {name}")
        axes.set_xlabel(r"angle of attack $\alpha$ [deg]")
        axes.set_ylabel(rf"$C_{'D' if key == 'cda' else 'L'} A$ [m$^2$]")
        axes.legend()
        style.letter(axes, mark)
    return figure


def mesh(tables: Table, simulations: Table) -> Figure:
    """Draw the drag of five meshes beside the tunnel, and their error against their size."""
    runs = simulations["run"]
    record = flight(tables, "flight30")
    figure = style.figure(2.8)
    grid = figure.subplots(1, 3)
    for axes, key, mark in zip(grid, ("cda", "cla"), "ab", strict=False):
        axes.plot(record["alpha_deg"], record[key], "o-", color=style.BLACK, markersize=4, label="wind tunnel")
        for name, colour, marker in zip(meshes(runs), COLOURS, "sD^v<", strict=False):
            run = run_of(runs, name, OMEGA)
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
        chosen = [run_of(runs, mesh_name, turbulence) for mesh_name in meshes(runs)]
        sizes, errors = [run["elements"] for run in chosen], [100 * drag_error(record, run) for run in chosen]
        axes.plot(sizes, errors, marker + "-", color=colour, markersize=4, label=name)
    axes.set_xscale("log")
    axes.set_ylim(0.0, 11.5)
    axes.set_xlabel("mesh elements")
    axes.set_ylabel("rms drag error [% of mean]")
    axes.legend(loc="upper left")


def hovering_drag(tables: Table) -> dict[float, dict[int, float]]:
    """Return drag area by rounded speed [m/s] and sideslip [deg]; the mean where two tests overlap."""
    found: dict[float, dict[int, list[float]]] = {}
    for table in tables["hovering"]:
        curve = found.setdefault(float(round(table["speed"])), {})
        for beta, area in zip(table["beta_deg"], table["cda"], strict=True):
            curve.setdefault(beta, []).append(area)
    return {speed: {b: float(np.mean(curve[b])) for b in sorted(curve)} for speed, curve in sorted(found.items())}


def flight(tables: Table, posture: str) -> Table:
    """Return the record of a flight posture."""
    found: Table = next(table for table in tables["flight"] if table["posture"] == posture)
    return found


def run_of(runs: Sequence[Table], mesh_name: str, turbulence: str) -> Table:
    """Return the simulations of flight30 with one mesh and turbulence model."""
    wanted = ("flight30", mesh_name, turbulence)
    return next(run for run in runs if (run["posture"], run["mesh"], run["turbulence"]) == wanted)


def meshes(runs: Sequence[Table]) -> list[str]:
    """Return the names of the meshes of flight30, coarsest first."""
    return sorted({run["mesh"] for run in runs if run["posture"] == "flight30"})


def measured_area(record: Table, key: str, run: Table) -> Array:
    """Return a force area of the tunnel at the angles of attack of a simulation."""
    areas = dict(zip(record["alpha_deg"], record[key], strict=True))
    return np.array([areas[alpha] for alpha in run["alpha_deg"]])


def drag_error(record: Table, run: Table) -> float:
    """Return the rms difference of the drag area over its mean in the tunnel."""
    tunnel = measured_area(record, "cda", run)
    return float(np.sqrt(np.mean((np.array(run["cda"]) - tunnel) ** 2)) / tunnel.mean())
