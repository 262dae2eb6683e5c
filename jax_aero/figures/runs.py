"""Result folders of flights and studies, read for figures; never written."""

from __future__ import annotations

import glob
from pathlib import Path

import xarray as xr

from jax_aero.base import kinds, run_file
from jax_aero.base.places import RESULTS, RUN_FILE, is_path
from jax_aero.base.terminal import Refused
from jax_aero.figures import style


class NotDrawn(Exception):
    """A figure cannot be drawn; the message states the reason and the remedy."""


class MissingRun(NotDrawn):
    """A figure lacks a flight or a package; the message names it and how to get it."""


def escape_text(text: object) -> str:
    """Return a text, in which `$` is an ordinary character if what stands between them cannot be typeset."""
    return str(text) if style.can_be_typeset(str(text)) else str(text).replace("$", r"\$")


def folder_of(results: Path, kind: str, name: str) -> Path:
    """Return the folder of a result of a kind; a flight's name may be a path."""
    return Path(name) if kind == "flight" and is_path(name) else results / kind / name


def load(results: Path, name: str, label: str | None = None) -> xr.Dataset:
    """Read the flight of this name, or in a folder given by its path, with a label in place of its name and title."""
    path = folder_of(results, "flight", name) / RUN_FILE
    if is_path(name) and not path.is_file():
        raise MissingRun(f"no flight in `{name}`; expected the folder of one")
    if not path.is_file():
        fly = kinds.find("flight")
        elsewhere = "" if results.resolve() == RESULTS.resolve() else f" --out {path.parents[1]}"
        changed = sorted(found.parent.name for found in path.parents[1].glob(f"{glob.escape(name)}--*/{RUN_FILE}"))
        there = f"; there are {', '.join(changed)}" if changed else ""
        line = fly.line(name, options=elsewhere)
        raise MissingRun(f"no flight `{name}` in {path.parents[1]}{there}; fly it with: {line}")
    flight = read(path)
    named = (path.parent.name, flight.attrs["title"]) if label is None else (label, label)
    return flight.assign_attrs(zip(("name", "title"), map(escape_text, named), strict=True))


def load_study(results: Path, kind: str, name: str) -> xr.Dataset:
    """Read a study of a kind, with its name as an attribute."""
    path = folder_of(results, kind, name) / RUN_FILE
    if not path.is_file():
        raise MissingRun(f"no study `{name}` in {path.parents[1]}; make it with: {kinds.find(kind).line(name)}")
    return read(path).assign_attrs(name=name)


def read(path: Path) -> xr.Dataset:
    """Read a result file; a damaged one counts as missing."""
    try:
        return run_file.read(path)
    except Refused as reason:
        raise MissingRun(str(reason)) from reason
