"""Pictures of kept results, drawn from their rows."""

from __future__ import annotations

import io

from jax_aero.figures import drawings, style
from jax_aero.results.kept import Kept

WIDTH, COLOURS = 1100, 256
"""Pixels, of which a page shows 760; with half of the colours, those of two lines become one."""


def draw(document: Kept) -> bytes:
    """Return the picture of a kept sweep, as a small WebP."""
    from PIL import Image

    style.use()
    drawn, picture = io.BytesIO(), io.BytesIO()
    drawings.draw(document.sweep).savefig(drawn)
    image = Image.open(drawn).convert("RGB")
    size = (WIDTH, round(image.height * WIDTH / image.width))
    image = image.resize(size, Image.Resampling.LANCZOS).quantize(COLOURS).convert("RGB")
    image.save(picture, "WEBP", lossless=True)
    return picture.getvalue()
