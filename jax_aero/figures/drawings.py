"""The drawing of a sweep, as its file says."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping

import matplotlib as mpl
from matplotlib.figure import Figure

from jax_aero.base.terminal import Refused
from jax_aero.figures import ablation, front, maps, model_pairs, pairs, runs, scatter, style
from jax_aero.sweep.result import SweepResult

DRAWINGS: Mapping[str, Callable[[SweepResult], Figure]] = {
    "levels": ablation.draw,
    "curve": ablation.draw,
    "map": maps.draw,
    "scatter": scatter.draw,
    "matrix": model_pairs.draw,
    "pairs": pairs.draw,
    "front": front.draw,
}

WIDTH, COLOURS = 1100, 256
"""Of a small picture: pixels, of which a page shows 760; with half of the colours, those of two lines become one."""


def draw(sweep: SweepResult, axis: str | None = None) -> Figure:
    """Return the figure of a sweep, drawn as its file says, or the paired differences between levels of an axis."""
    texts = [sweep.title, *(axis["label"] for axis in sweep.document["axes"])]
    texts += [level for axis in sweep.document["axes"] for level in axis["levels"] if isinstance(level, str)]
    try:
        # Texts come from files: if one has dollars but no mathematics, they are ordinary characters.
        with mpl.rc_context({"text.parse_math": all(map(style.can_be_typeset, texts))}):
            if axis:
                from jax_aero.figures import paired  # needs pyarrow, which the extra of figures does not bring

                return paired.draw(sweep, axis)
            return DRAWINGS[sweep.document["drawing"]](sweep)
    except Refused as reason:
        raise runs.NotDrawn(str(reason)) from None
    except KeyError as missing:
        raise runs.NotDrawn(f"its tables have no {missing}; --overwrite flies it again") from None


def draw_small(sweep: SweepResult) -> bytes:
    """Return the figure of a sweep as a small WebP."""
    from PIL import Image

    style.use()
    drawn, picture = io.BytesIO(), io.BytesIO()
    draw(sweep).savefig(drawn)
    image = Image.open(drawn).convert("RGB")
    size = (WIDTH, round(image.height * WIDTH / image.width))
    image = image.resize(size, Image.Resampling.LANCZOS).quantize(COLOURS).convert("RGB")
    image.save(picture, "WEBP", lossless=True)
    return picture.getvalue()
