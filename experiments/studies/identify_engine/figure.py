"""An engine identified from one log of a test bench, on another log: throttle, thrust, and errors."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from paper_figs import style
from paper_figs.entry import Entry


def draw(study: xr.Dataset) -> Figure:
    """Draw throttle, thrust, and the errors of the simulated and of the estimated thrust."""
    time = study["time"]
    figure = style.figure(5.2)
    throttle, thrust, error = figure.subplots(3, 1, sharex=True, height_ratios=(0.7, 1.2, 1.0))
    throttle.plot(time, study["throttle"], color=style.BLACK)
    throttle.set_ylabel("throttle [%]")
    thrust.plot(time, study["thrust"], ".", color=style.GREY, markersize=1.5, label="log that was held out")
    thrust.plot(time, study["thrust_identified"], color=style.BLUE, label="identified, from the first sample")
    thrust.set_ylabel("thrust [N]")
    thrust.legend()
    reference = study["thrust_file"]
    for name, colour, label in (
        ("thrust_identified", style.BLUE, "simulated"),
        ("estimate_tuned", style.GREEN, "estimator, tuned"),
        ("estimate_published", style.VERMILION, "estimator, published Q and R"),
    ):
        found = study[name].sel(state="T") if "state" in study[name].dims else study[name]
        error.plot(time, found - reference, color=colour, linewidth=0.8, label=label)
    error.set_ylabel("thrust error [N]")
    error.set_xlabel("time [s]")
    error.legend(ncols=3)
    style.letters((throttle, thrust, error))
    return figure


FIGURES = {
    "engine": Entry(draw, "an engine identified from a log, on another log", "identify_engine", ("P220",)),
}
