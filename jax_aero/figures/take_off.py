"""Take-off and landing: height, load of jets and feet, and attitude in a flight that starts and ends on the ground."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.base import flights
from jax_aero.figures import panels, style


def draw(run: xr.Dataset) -> Figure:
    """Draw one flight that starts and ends on the ground."""
    flown = flights.until_loss(run)
    time, airborne = flown["time"], flown["feet_carry"].values == 0.0
    figure = style.figure(6.4)
    grid = figure.subplots(4, 1, sharex=True)
    height, load_, thrust, attitude = grid
    height.plot(time, flown["com_position"].sel(xyz="z"), color=style.BLUE, label="CoM")
    height.plot(time, flown["com_setpoint"].sel(xyz="z"), "--", color=style.GREY, label="set-point")
    height.set_ylabel("height [m]")
    jets = flown["thrust"].sum("jet")
    feet = flown["foot_wrench"].isel(six=2).sum("foot")
    load_.plot(time, jets, color=style.VERMILION, label="sum of thrusts")
    load_.plot(time, feet, color=style.GREEN, label="vertical force of the feet", linewidth=0.9)
    load_.set_ylabel("load [N]")
    top, most = 1.3 * float(jets.max()), float(feet.max())
    load_.set_ylim(0.0, top)
    if most > top:  # in one tick at the landing
        at = float(time[feet.values.argmax()]), 0.6 * top
        load_.annotate(f"to {most:.0f} N ", at, ha="right", fontsize=7, color=style.GREEN)
    panels.thrusts(thrust, run)
    panels.line(attitude, flown["rotation_error"], color=style.BLUE)
    attitude.set_ylim(bottom=0.0)
    attitude.set_xlabel("time [s]")
    for axes in grid:
        axes.fill_between(
            time, 0.0, 1.0, where=airborne, transform=axes.get_xaxis_transform(), color=style.GREY, alpha=0.12,
            label="in the air" if axes is height else None,
        )  # fmt: skip
        panels.mark_loss(axes, run)
    for axes in (height, load_, thrust):
        style.legend(axes, loc="upper right", ncols=4)
    height.set_xlim(0.0, float(run["time"][-1]))
    return figure
