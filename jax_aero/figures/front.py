"""Time of missions against the share of their flights that complete or land: one panel for each fault."""

from __future__ import annotations

import re

from matplotlib.figure import Figure

from jax_aero.figures import style
from jax_aero.figures.ablation import SERIES, legend
from jax_aero.figures.sweeps import require
from jax_aero.sweep.intervals import SHARE, share
from jax_aero.sweep.result import SweepResult

TIMED = re.compile(r"(?P<kind>.+), (?P<time>[\d.]+) s")
"""Label of a mission: those of one kind have one colour."""


def draw(sweep: SweepResult) -> Figure:
    """Draw a sweep whose first axis has missions, over all levels of the axes that are no panels."""
    missions = sweep.axes[0] if sweep.axes else {"name": "", "levels": []}
    timed = {level: match for level in missions["levels"] if (match := TIMED.fullmatch(str(level)))}
    panel = sweep.panel_axis
    suits = panel is not None and missions["name"] and len(timed) == len(missions["levels"])
    require(sweep, bool(suits), "missions such as `upright, 14 s`, and panels")
    assert panel is not None
    counts = sweep.cells.groupby([panel["name"], missions["name"]])[["flights", "upright"]].sum()
    kinds = dict.fromkeys(match["kind"] for match in timed.values())
    figure = style.figure(2.9)
    row = figure.subplots(1, len(panel["levels"]), sharex=True, sharey=True, squeeze=False)[0]
    for axes, fault in zip(row, panel["levels"], strict=True):
        for kind, (colour, marker, _) in zip(kinds, SERIES, strict=False):
            points = [
                (float(match["time"]), *counts.loc[(fault, level)])
                for level, match in timed.items()
                if match["kind"] == kind
            ]
            times, shares = zip(*((time, share(upright, flights)) for time, flights, upright in points), strict=True)
            middles, *ends = zip(*shares, strict=True)
            axes.vlines(times, *ends, color=colour)
            axes.plot(times, middles, marker, color=colour, markersize=4, label=kind)
        axes.set_title(fault, fontsize=7.5)
        axes.set_xlabel("duration of the mission [s]")
    row[0].set_ylabel(SHARE.replace(", ", ",\n"))
    row[0].set_ylim(-2.0, 102.0)
    legend(figure, row[0], sweep.title, len(kinds))
    style.footnote(figure, f"{counts['flights'].max()} flights a point, {sweep.each.partition(', ')[2]}")
    return figure
