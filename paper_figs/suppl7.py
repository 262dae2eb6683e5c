"""Supplementary Fig. 7: joint errors, total force and thrusts of the tests, and the difference of two models.

a–c TEST1    d–f TEST2    g–i TEST3    j robustness: simulator's minus controller's total force
"""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from jax_aero.figures import panels, style
from jax_aero.figures.entry import Entry


def draw(*runs: xr.Dataset) -> Figure:
    """Draw the figure from four runs, in panels a to c, d to f, g to i, and j."""
    figure = style.figure(9.6)
    *tests, lower = figure.subfigures(4, 1, squeeze=False)[:, 0]
    for part, run, letters in zip(tests, runs[:3], ("abc", "def", "ghi"), strict=True):
        panels.row(part, run, letters)
    panels.row(lower, runs[3], "j", control=True, last=panels.aero_force_difference)
    end = max(float(run["time"][-1]) for run in runs)
    for axes in figure.axes:
        axes.set_xlim(0.0, end)
    return figure


TESTS = ("test1", "test2", "test3", "robustness")
FIGURES = {
    "suppl7": Entry(draw, "Suppl. Fig. 7: TEST1, TEST2, TEST3, robustness; corrected arms", "flight", TESTS),
    "suppl7_published": Entry(
        draw, "Suppl. Fig. 7; published arms", "flight", tuple(f"{name}_published" for name in TESTS)
    ),
}
