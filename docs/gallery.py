"""Copy the figures that `docs/gallery.md` shows from `results/figures/` to `docs/img/gallery/`, small enough to keep.

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
SHOWN = re.compile(r"!\[[^\]]*\]\(img/gallery/(?P<name>\w+)\.png\)")
WIDTH = 1100  # pixels; a page is 760 wide
COLOURS = 128
DEMO = ("demo", "demo_dark")


def main() -> int:
    """Copy every figure the gallery shows; return how many are missing."""
    target = ROOT / "docs/img/gallery"
    target.mkdir(exist_ok=True)
    missing = 0
    for name in (*DEMO, *SHOWN.findall((ROOT / "docs/gallery.md").read_text(encoding="utf-8"))):
        drawn = ROOT / "results/figures" / f"{name}.png"
        if not drawn.is_file():
            print(f"{name}: not drawn yet; jax-aero figures {name.removesuffix('_dark')} --dark", file=sys.stderr)
            missing += 1
            continue
        if name in DEMO:
            shutil.copy(drawn, ROOT / "docs/img")
            continue
        picture = Image.open(drawn).convert("RGB")
        height = round(picture.height * WIDTH / picture.width)
        picture.resize((WIDTH, height), Image.Resampling.LANCZOS).quantize(COLOURS).save(
            target / f"{name}.png", optimize=True
        )
    return missing


if __name__ == "__main__":
    raise SystemExit(main())
