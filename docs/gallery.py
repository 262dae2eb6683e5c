"""Copy the figures of the gallery and of the studies' pages from `results/figures/` beside them, small enough to keep.

The demo's figure goes to `docs/img/` as it is, with the one for dark pages of `jax-aero figures demo --dark`. Run after
`make reproduce SWEEPS=--all`; a figure that has not been drawn is named, and its old copy stays.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
SHOWN = re.compile(r"!\[[^\]]*\]\((?P<path>(?:img/gallery/)?\w+\.png)\)")
PAGES = (ROOT / "docs/gallery.md", ROOT / "docs/ahead.md", *sorted((ROOT / "experiments/studies").glob("*/README.md")))
WIDTH = 1100  # pixels; a page is 760 wide
COLOURS = 256  # with half of them, colours of two lines become one
DEMO = ("demo", "demo_dark")


def main() -> int:
    """Copy every figure that is shown; return how many are missing."""
    shown = [page.parent / path for page in PAGES for path in SHOWN.findall(page.read_text(encoding="utf-8"))]
    missing = 0
    for target in (*(ROOT / f"docs/img/{name}.png" for name in DEMO), *shown):
        drawn = ROOT / "results/figures" / target.name
        if not drawn.is_file():
            name = target.stem.removesuffix("_dark")
            print(f"{target.stem}: not drawn yet; jax-aero figures {name} --dark", file=sys.stderr)
            missing += 1
        elif target.stem in DEMO:
            shutil.copy(drawn, target)
        else:
            picture = Image.open(drawn).convert("RGB")
            size = (WIDTH, round(picture.height * WIDTH / picture.width))
            picture.resize(size, Image.Resampling.LANCZOS).quantize(COLOURS).save(target, optimize=True)
    return missing


if __name__ == "__main__":
    raise SystemExit(main())
