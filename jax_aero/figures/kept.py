"""Pictures of kept results, drawn from their rows."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
import pandas as pd

from jax_aero.figures import drawings, style
from jax_aero.figures.sweeps import Sweep
from jax_aero.results import kept
from jax_aero.results.kept import Kept

WIDTH, COLOURS = 1100, 256
"""Pixels, of which a page shows 760; with half of the colours, those of two lines become one."""


@dataclass(frozen=True)
class KeptSweep(Sweep):
    """A kept sweep, drawn as a finished one; errors are those of flights that complete or come down."""

    kept: Kept

    spread = "median to 90 % of flights that complete or land"

    @cached_property
    def cells(self) -> pd.DataFrame:
        """Return one row per cell."""
        return pd.DataFrame(self.kept.cells()).fillna(np.nan)

    def footnote(self) -> str:
        """Return the number of flights of a cell, and whether they differ."""
        return f"flights: {self.kept.each}"


def sweep_of(document: Kept) -> KeptSweep:
    """Return a kept sweep as one that can be drawn."""
    axes = [msgspec.to_builtins(axis) for axis in document.axes]
    shown = {"title": document.title, "drawing": document.drawing, "panels": document.panels, "axes": axes}
    return KeptSweep(document.name, shown, kept.FOLDER, document)


def draw(document: Kept) -> bytes:
    """Return the picture of a kept sweep, as a small WebP."""
    from PIL import Image

    style.use()
    drawn, picture = io.BytesIO(), io.BytesIO()
    drawings.draw(sweep_of(document)).savefig(drawn)
    image = Image.open(drawn).convert("RGB")
    size = (WIDTH, round(image.height * WIDTH / image.width))
    image = image.resize(size, Image.Resampling.LANCZOS).quantize(COLOURS).convert("RGB")
    image.save(picture, "WEBP", lossless=True)
    return picture.getvalue()
