"""The use of aerodynamic feedback: three controllers, with corrected and with published lever arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from paper_figs import panels, style
from paper_figs.runs import Run, Series

COLUMNS = ("corrected lever arms", "published lever arms")
CONTROLLERS = (
    ("baseline", style.VERMILION, "-"),
    ("aerodynamic-aware", style.BLUE, "--"),
    ("observer, no model", style.GREEN, ":"),
)


def draw(*runs: Run) -> Figure:
    """Draw six runs: baseline, aware and observer with corrected arms, then the same with published arms."""
    figure = style.figure(9.4)
    grid = figure.subplots(6, 2, sharex=True, sharey="row", height_ratios=(1.2, 1.2, 1.2, 1.2, 1.2, 0.8))
    for column, title in enumerate(COLUMNS):
        same_arms = runs[len(CONTROLLERS) * column :][: len(CONTROLLERS)]
        grid[0, column].annotate(
            title,
            (0.5, 1.0),
            (0, 20),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="center",
            size=9,
            weight="bold",
        )
        _error(grid[0, column], same_arms, Run.rotation_error_deg, says_ending=True)
        grid[0, column].set(title="base rotation error", ylabel="error [deg]")
        _error(grid[1, column], same_arms, Run.com_error, says_ending=False)
        grid[1, column].set(title="distance of the CoM from its reference", ylabel="error [m]")
        for row, (run, (controller, _, _)) in enumerate(zip(same_arms, CONTROLLERS, strict=True), start=2):
            panels.thrusts(grid[row, column], run)
            grid[row, column].set_title(f"thrusts, {controller}")
            if run.lost_time is not None:
                style.mark_fall(grid[row, column], run.lost_time)
        panels.wind(grid[-1, column], max(same_arms, key=lambda run: run.data.sizes["time"]))
        grid[-1, column].set_xlabel("time [s]")
    for axes in grid[:, 1]:
        axes.set_ylabel("")
    for row, columns in ((0, 1), (2, 2), (5, 3)):
        style.legend(grid[row, 0], ncols=columns)
    for axes in grid[:2, 0]:
        axes.set_ylim(bottom=0.0)  # last, since it disables autoscaling, for the whole row
    grid[0, 0].set_xlim(0.0, max(float(run.data["time"][-1]) for run in runs))
    return figure


def _error(axes: Axes, runs: Sequence[Run], of: Callable[[Run], Series], *, says_ending: bool) -> None:
    for run, (controller, colour, dash) in zip(runs, CONTROLLERS, strict=True):
        error = of(run)
        axes.plot(error["time"], error, dash, color=colour, label=controller)
        if run.lost_time is not None:
            style.mark_fall(axes, run.lost_time, run.ending if says_ending else None)
