"""Draw pictures of pages anew: `python -m docs.gallery NAME ...`; without names, those of flights and tables.

`flight` and `engine_out` are the front page's films. A picture of flights flies them first, and names how each ended.
One of a study computes the study.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from jax_aero.base import places
from jax_aero.base.controllers import CONTROLLERS
from jax_aero.base.files import read_json
from jax_aero.commands import fly
from jax_aero.data import tables as measured
from jax_aero.figures import style
from jax_aero.figures.catalogue import FIGURES
from jax_aero.figures.entry import Entry

ROOT = Path(__file__).resolve().parents[1]
SHOWN = re.compile(r"!\[[^\]]*\]\((?P<path>(?:img/(?:gallery/)?)?\w+\.png)\)")
PAGES = (*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "experiments/studies").glob("*/README.md")))
WIDTH = 1100  # pixels; a page is 760 wide
COLOURS = 256  # with half of them, colours of two lines become one
DEMO = "demo"
"""Figure that is drawn small, and also for dark pages."""
MADE_OF = "Made of"
"""Text of a PNG that says what a picture shows."""
DESCRIPTION = 0x010E
"""EXIF's tag of the same text in a film."""


class Film(NamedTuple):
    """Flights side by side."""

    shown: Mapping[str, str]
    """Experiments with their controllers."""
    cut: str
    """Options of `jax-aero view video`."""

    @staticmethod
    def path(name: str) -> Path:
        """Return the file of a film of `FILMS`."""
        return ROOT / f"docs/img/{name}.webp"


FILMS = {
    "flight": Film(
        {
            "test1_gale": "baseline",
            "test2_gale": "aero_aware",
            "test1_observer_gale": "observer_without_model",
            "robot_gale": "robot",
        },
        "--camera side --size 960x480 --fps 10 --speed 3 --start 4 --end 31",
    ),
    "engine_out": Film(
        {"test2_arm_engine_out": "aero_aware", "robot_arm_engine_out": "robot"},
        "--size 960x480 --fps 10 --speed 1.5 --start 27",
    ),
}
FIGURES_OF_A_FLIGHT = ("max_rotation_error", "max_com_error", "thrust_max", "end_com_z")


def main() -> int:
    """Draw pictures; return the exit status."""
    names = sys.argv[1:] or [name for name in pictures() if FIGURES[name].kind in ("flight", "")]
    if unknown := [name for name in names if name not in {*pictures(), *FILMS}]:
        print(f"error: no page shows a figure `{unknown[0]}`", file=sys.stderr)
        return 2
    style.use()
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            if name in FILMS:
                film(name, Path(folder))
            else:
                draw(name, pictures()[name], Path(folder))
    return 0


def pictures() -> dict[str, Path]:
    """Return the pictures of figures that pages show, by the figure's name."""
    shown = [page.parent / path for page in PAGES for path in SHOWN.findall(page.read_text(encoding="utf-8"))]
    return {path.stem: path for path in (*shown, ROOT / f"docs/img/{DEMO}.png") if path.stem in FIGURES}


def draw(name: str, target: Path, folder: Path) -> None:
    """Fly or compute what a figure shows, draw it, and write it small enough to keep."""
    entry, shown = FIGURES[name], dict[str, Any]()
    results = folder / "flight"
    if entry.kind == "flight":
        fly.main([*entry.runs, "--out", str(results)])
        shown = {run: of_flight(read_json(results / run / places.MANIFEST_FILE, dict)) for run in entry.runs}
    elif entry.tables:
        shown = tables(entry)
    else:
        results = places.RESULTS / "flight"
        for command in entry.commands:
            subprocess.run([sys.executable, "-m", "jax_aero", *command.split()[1:]], check=True)
    figure, _ = entry.draw_from_results(results)
    for drawn in style.save(figure, name, folder, {}, dark=name == DEMO):
        if drawn.suffix == ".png":
            _write(drawn, target.with_name(drawn.name), shown, is_small=name == DEMO)


def film(name: str, folder: Path) -> None:
    """Fly what a film shows, and film it."""
    film, target = FILMS[name], Film.path(name)
    fly.main([*film.shown, "--out", str(folder)])
    first, *others = (str(folder / run) for run in film.shown)
    titles = [CONTROLLERS[controller].label for controller in film.shown.values()]
    shown = ["--beside", *others, "--titles", *titles, *film.cut.split()]
    words = ["view", "video", first, *shown, "--out", str(folder / target.name)]
    subprocess.run([sys.executable, "-m", "jax_aero", *words], check=True)
    made = {run: of_flight(read_json(folder / run / places.MANIFEST_FILE, dict)) for run in film.shown}
    target.write_bytes(described((folder / target.name).read_bytes(), json.dumps(made)))


def described(film: bytes, text: str) -> bytes:
    """Return an animated WebP with a description, as a chunk of EXIF at its end, which the byte of flags announces."""
    made_of = Image.Exif()
    made_of[DESCRIPTION] = text
    held = made_of.tobytes()
    chunk = b"EXIF" + len(held).to_bytes(4, "little") + held + b"\0" * (len(held) % 2)
    size = (len(film) - 8 + len(chunk)).to_bytes(4, "little")
    return film[:4] + size + film[8:20] + bytes([film[20] | 8]) + film[21:] + chunk


def _write(drawn: Path, target: Path, shown: Mapping[str, Any], *, is_small: bool) -> None:
    picture: Image.Image = Image.open(drawn)
    text = PngInfo()
    text.add_text(MADE_OF, json.dumps(shown))
    if not is_small:
        size = (WIDTH, round(picture.height * WIDTH / picture.width))
        picture = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS).quantize(COLOURS)
    picture.save(target, optimize=True, pnginfo=text)
    print(target.relative_to(ROOT))


def made_of(target: Path) -> dict[str, Any] | None:
    """Return what a picture says that it shows."""
    with Image.open(target) as picture:
        text = getattr(picture, "text", {}).get(MADE_OF) or picture.getexif().get(DESCRIPTION)
    return None if text is None else dict(json.loads(text))


def of_flight(flight: Mapping[str, Any]) -> list[Any]:
    """Return how a flight ended, from its outcome and its summary."""
    summary = flight["summary"]
    return [flight["outcome"], *(float(f"{summary[figure]:.5g}") for figure in FIGURES_OF_A_FLIGHT)]


def tables(entry: Entry) -> dict[str, str]:
    """Return the hashes of the tables that a figure shows."""
    return dict(measured.hashes(*entry.tables))


if __name__ == "__main__":
    raise SystemExit(main())
