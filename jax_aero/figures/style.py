"""Appearance of all figures, and saving.

The colours are from the palette of Okabe and Ito, which colour-blind readers can distinguish; line styles repeat the
distinction where lines cross or the page is printed in grey.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import matplotlib as mpl
import matplotlib.image
import matplotlib.style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.mathtext import MathTextParser
from numpy.typing import NDArray

BLACK = "#000000"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#7F7F7F"
LIGHT = "#D9D9D9"

AXES_COLOURS = {"x": VERMILION, "y": GREEN, "z": BLUE}
GROUP_COLOURS = (BLACK, ORANGE, SKY, GREEN, PURPLE, BLUE, VERMILION, GREY)
JET_COLOURS = (VERMILION, BLUE, ORANGE, GREEN, PURPLE, SKY, BLACK, GREY)
JET_DASHES = ("-", "--")
"""Colours and dashes of groups of joints and of jets, in the robot's order; repeated if there are more."""

FULL_WIDTH = 7.2
"""Two columns of a journal page [inches]."""

SETTINGS: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.labelsize": 8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 8.5,
    "figure.dpi": 100,
    "font.size": 8,
    "grid.color": LIGHT,
    "grid.linewidth": 0.5,
    "legend.borderaxespad": 0.2,
    "legend.fontsize": 7,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.1,
    "pdf.fonttype": 42,  # embed fonts, so that text remains editable
    "savefig.dpi": 200,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
}


def use() -> None:
    """Apply this style to all following figures, in place of the user's settings: equal results give equal figures."""
    mpl.rcdefaults()
    mpl.style.use(SETTINGS)


def figure(height: float, width: float = FULL_WIDTH) -> Figure:
    """Return an empty figure of this size [inches], drawn to files only."""
    empty = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(empty)
    return empty


def can_be_typeset(text: str) -> bool:
    """Return whether the mathematics of a text, between dollars, can be drawn; a text without any can."""
    try:
        MathTextParser("path").parse(text)
    except ValueError:
        return False
    return True


def letter(axes: Axes, text: str) -> None:
    """Draw a bold panel letter above the left corner of the axes."""
    axes.text(-0.08, 1.04, text, transform=axes.transAxes, fontweight="bold", fontsize=10, ha="right", va="bottom")


def letters(panels: Iterable[Axes], marks: str = ascii_lowercase) -> None:
    """Draw consecutive letters above the panels."""
    for axes, mark in zip(panels, marks, strict=False):
        letter(axes, mark)


def title(figure: FigureBase, text: str, size: float = 9.5) -> None:
    """Put a title above the left corner of a figure, or of its part."""
    figure.suptitle(text, fontsize=size, fontweight="bold", x=0.01, ha="left")


def footnote(figure: FigureBase, text: str) -> None:
    """Put a small note below the right corner of a figure."""
    figure.supxlabel(text, fontsize=6.5, color=GREY, x=0.99, ha="right")


def legend(axes: Axes, handles: Sequence[Artist] | None = None, **options: Any) -> None:
    """Put a legend into the axes, if there is something to name: a robot without jets has no thrusts."""
    if handles := axes.get_legend_handles_labels()[0] if handles is None else handles:
        axes.legend(handles=handles, **options)


def legend_above(axes: Axes, columns: int, handles: Sequence[Artist] | None = None) -> None:
    """Put a narrow legend above the axes, where it hides no data."""
    legend(
        axes,
        handles,
        loc="lower left",
        bbox_to_anchor=(-0.02, 1.0),
        ncols=columns,
        fontsize=6.5,
        columnspacing=0.8,
        handlelength=1.3,
        handletextpad=0.4,
    )


def mark_fall(axes: Axes, time: float, label: str | None = None) -> None:
    """Draw the time of a fall as a vertical line with a cross at its foot."""
    axes.axvline(time, color=GREY, linewidth=0.9, linestyle=":")
    axes.plot(time, 0.0, "X", color=VERMILION, markersize=6, transform=axes.get_xaxis_transform(), clip_on=False)
    if label:
        axes.annotate(
            label,
            (time, 0.97),
            xycoords=axes.get_xaxis_transform(),
            xytext=(3, 0),
            textcoords="offset points",
            fontsize=7,
            color=VERMILION,
            va="top",
        )


def save(figure: Figure, name: str, out: Path, hashes: Mapping[str, str], *, dark: bool = False) -> list[Path]:
    """Write NAME.pdf and NAME.png with the configuration hash of every run shown; with `dark`, also NAME_dark.png."""
    out.mkdir(parents=True, exist_ok=True)
    runs = "; ".join(f"{run} config {digest}" for run, digest in hashes.items())
    paths = [out / f"{name}.pdf", out / f"{name}.png"]
    # Without dates, so that equal results give equal bytes.
    figure.savefig(paths[0], metadata={"Title": name, "Subject": runs, "CreationDate": None, "ModDate": None})
    figure.savefig(paths[1], metadata={"Title": name, "Description": runs})
    if dark:
        paths.append(out / f"{name}_dark.png")
        mpl.image.imsave(paths[-1], _darken(figure), metadata={"Title": name, "Description": runs})
    return paths


def _darken(figure: Figure) -> NDArray[np.float32]:
    """Return the figure as RGBA for a dark page: no background, opposite lightness, equal hue."""
    drawn = BytesIO()
    figure.savefig(drawn, transparent=True)
    drawn.seek(0)
    picture = np.array(mpl.image.imread(drawn))
    colours = picture[..., :3]
    colours += 1.0 - colours.max(axis=-1, keepdims=True) - colours.min(axis=-1, keepdims=True)
    return picture
