"""Take-off and landing: height, load of jets and feet, and attitude in a flight that starts and ends on the ground."""

from __future__ import annotations

from matplotlib.figure import Figure

from paper_figs import panels, style
from paper_figs.runs import Run


def draw(run: Run) -> Figure:
    """Draw one flight that starts and ends on the ground."""
    flown = run.log_to_loss
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
    load_.set_ylim(0.0, 1.3 * float(jets.max()))  # excludes the spike of one tick at the landing
    panels.thrusts(thrust, run)
    attitude.plot(time, run.rotation_error_deg(), color=style.BLUE)
    attitude.set_ylabel("rotation error [deg]")
    attitude.set_ylim(bottom=0.0)
    attitude.set_xlabel("time [s]")
    for axes in grid:
        axes.fill_between(
            time, 0.0, 1.0, where=airborne, transform=axes.get_xaxis_transform(), color=style.GREY, alpha=0.12
        )
        if run.lost_time is not None:
            style.mark_fall(axes, run.lost_time, run.ending)
    for axes in (height, load_, thrust):
        style.legend(axes, loc="upper right", ncols=4)
    height.set_xlim(0.0, float(run.data["time"][-1]))
    return figure
