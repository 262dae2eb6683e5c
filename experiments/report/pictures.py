"""Pictures of kept results: `docs/results/NAME.webp`, drawn from the rows of NAME.json, which they name by a digest."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from experiments.report import kept
from experiments.report.kept import Kept
from jax_aero.base.files import write_bytes
from paper_figs import style
from paper_figs.command import draw_sweep
from paper_figs.sweeps import Sweep

WIDTH, COLOURS = 1100, 256
"""Pixels, of which a page shows 760; with half of the colours, those of two lines become one."""

MOST_LEVELS = 16
"""Greatest number of levels that are drawn in rows: the picture of more repeats the table."""

DESCRIPTION = 0x010E
"""EXIF's tag of the text that names the rows."""


@dataclass(frozen=True)
class KeptSweep(Sweep):
    """A kept sweep, drawn as a finished one; errors are those of flights that complete or come down."""

    kept: Kept

    spread = "median to 90 % of flights"

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


def is_drawn(document: Kept) -> bool:
    """Return whether a picture adds to the table, and needs no more than its rows."""
    if document.drawing in ("levels", "front"):
        return all(len(axis.levels) <= MOST_LEVELS for axis in document.axes)
    return document.drawing in ("curve", "map") and not document.pooled


def digest(document: Kept) -> str:
    """Return the digest of what a picture shows."""
    parts = (document.title, document.each, document.drawing, document.panels, document.axes)
    shown = msgspec.json.encode([*parts, document.columns, document.rows])
    return hashlib.sha256(shown).hexdigest()[:16]


def digest_in(path: Path) -> str | None:
    """Return the digest that a picture names."""
    from PIL import Image

    with Image.open(path) as image:
        return image.getexif().get(DESCRIPTION)


def draw(document: Kept) -> bytes:
    """Return the picture of a kept sweep, small enough to keep."""
    from PIL import Image

    style.use()
    drawn, picture = io.BytesIO(), io.BytesIO()
    draw_sweep(sweep_of(document)).savefig(drawn)
    image = Image.open(drawn).convert("RGB")
    size = (WIDTH, round(image.height * WIDTH / image.width))
    image = image.resize(size, Image.Resampling.LANCZOS).quantize(COLOURS).convert("RGB")
    made_of = Image.Exif()
    made_of[DESCRIPTION] = digest(document)
    image.save(picture, "WEBP", lossless=True, method=6, exif=made_of)
    return picture.getvalue()


def outdated() -> Iterator[Path]:
    """Yield the pictures that are not there, are of other rows, or of nothing that is kept."""
    drawn = {kept.FOLDER / f"{name}.webp": kept.read(name) for name in kept.names() if is_drawn(kept.read(name))}
    for path, document in drawn.items():
        if not path.is_file() or digest_in(path) != digest(document):
            yield path
    yield from (path for path in sorted(kept.FOLDER.glob("*.webp")) if path not in drawn)


def update() -> Iterator[Path]:
    """Draw the pictures that are outdated, and remove those of nothing; yield them."""
    for path in list(outdated()):
        if path.stem in kept.names() and is_drawn(document := kept.read(path.stem)):
            write_bytes(path, draw(document))
        else:
            path.unlink()
        yield path
