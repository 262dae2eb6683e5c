"""Result folders of flights and studies, read for figures; never written."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from jax_aero.base import run_file
from jax_aero.base.places import RESULTS, RUN_FILE, is_path
from jax_aero.base.terminal import Refused
from paper_figs import style


class NotDrawn(Exception):
    """A figure cannot be drawn; the message states the reason and the remedy."""


class MissingRun(NotDrawn):
    """A figure lacks a flight or a package; the message names it and how to get it."""


def escape_text(text: object) -> str:
    """Return a text, in which `$` is an ordinary character if what stands between them cannot be typeset."""
    return str(text) if style.can_be_typeset(str(text)) else str(text).replace("$", r"\$")


def folder_of(results: Path, kind: str, name: str) -> Path:
    """Return the folder of a result of a kind; `results` is that of flights, and a flight's name may be a path."""
    if kind != "flight":
        return results.parent / kind / name
    return Path(name) if is_path(name) else results / name


def load(results: Path, name: str, label: str | None = None) -> xr.Dataset:
    """Read the flight of this name, or in a folder given by its path, with a label in place of its name and title."""
    path = folder_of(results, "flight", name) / RUN_FILE
    if is_path(name) and not path.is_file():
        raise MissingRun(f"no flight in `{name}`; expected the folder of one")
    if not path.is_file():
        elsewhere = "" if results.resolve() == (RESULTS / "flight").resolve() else f" --out {results}"
        raise MissingRun(f"no flight `{name}` in {results}; fly it with: jax-aero fly {result_words(name, elsewhere)}")
    flight = read(path)
    named = (path.parent.name, flight.attrs["title"]) if label is None else (label, label)
    return flight.assign_attrs(zip(("name", "title"), map(escape_text, named), strict=True))


def load_study(results: Path, kind: str, name: str) -> xr.Dataset:
    """Read a study of a kind, with its name as an attribute; `results` is the folder of flights beside it."""
    path = folder_of(results, kind, name) / RUN_FILE
    if not path.is_file():
        raise MissingRun(f"no study `{name}` in {path.parents[1]}; make it with: {study_command(kind, name)}")
    return read(path).assign_attrs(name=name)


def study_command(kind: str, name: str) -> str:
    """Return the command that makes a study."""
    word = {"training": "train", "cfd_flow": "cfd flow", "cfd_taps": "cfd taps", "fit_aero": "data fit-aero"}.get(
        kind, f"study {kind}"
    )
    options = {"training": " --dataset FILE", "trim": " --map"}.get(kind, "")
    return f"jax-aero {word} {result_words(name, options)}"


def result_words(name: str, options: str = "") -> str:
    """Return the command line words that make a result: `test2--wind.seed=3` is `test2` with an override."""
    stem, changed, _ = name.partition("--")
    return f"{stem}{options}" + (" --set ... (the changes in its name)" if changed else "")


def read(path: Path) -> xr.Dataset:
    """Read a result file; a damaged one counts as missing."""
    try:
        return run_file.read(path)
    except Refused as reason:
        raise MissingRun(str(reason)) from reason
