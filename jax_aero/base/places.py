"""Locations of files: configurations in the package; results in the checkout or, without one, in the current folder."""

from __future__ import annotations

import difflib
import hashlib
import re
from collections.abc import Iterable
from os import PathLike, fspath
from pathlib import Path

from jax_aero.base.terminal import Refused

CONFIGS = (Path(__file__).parents[1] / "configs").resolve()
"""`configs/` of a checkout, through a link in the package, or the package's own copy."""

ROBOT = CONFIGS / "robot" / "ironcub_mk1.toml"
"""The paper's robot."""

HOME = CONFIGS.parent
"""Folder that paths in manifests are relative to."""

IS_CHECKOUT = (HOME / "rust").is_dir()

STUDIES = HOME / "experiments" / "studies"
"""Folders of studies, with their configurations; there is none without a checkout."""

RESULTS = Path("results") if not Path().exists() else (HOME if IS_CHECKOUT else Path.cwd()) / "results"


RUN_FILE, MANIFEST_FILE, SWEEP_FILE = "run.nc", "manifest.json", "sweep.json"
"""Files of a result folder: every signal, and how it was made; the last is the manifest of a sweep."""


def folder_of(kind: str) -> Path:
    """Return the folder of a kind of configuration: that of the study of this name, or else of `configs/`."""
    study = STUDIES / kind
    return study if study.is_dir() else CONFIGS / kind


def shown_folder(kind: str) -> str:
    """Return the folder of a kind of configuration as messages name it."""
    return f"{folder_of(kind).parent.name}/{kind}"


def names(kind: str) -> list[str]:
    """Return the names of all configurations of a kind."""
    return sorted(path.stem for path in folder_of(kind).glob("*.toml"))


def is_path(text: str) -> bool:
    """Return whether a text is the path of a file rather than a name."""
    return "/" in text or text.lower().endswith(".toml")


def name_of(text: str) -> str:
    """Return the name of an item given by name or path.

    >>> name_of("mine/test2.toml")
    'test2'
    """
    return Path(text).stem if is_path(text) else text


def find(kind: str, name: str | PathLike[str]) -> Path:
    """Return a configuration of a kind by its name, or any file by its path.

    >>> find("experiments", "test2").name
    'test2.toml'
    """
    text = fspath(name)
    if is_path(text) or not isinstance(name, str):
        return Path(text)
    folder = folder_of(kind)
    if text not in (known := names(kind)):
        if Path(f"{text}.toml").is_file():
            raise Refused(f"there is no `{text}` in {shown_folder(kind)}; did you mean {text}.toml, which is here?")
        raise Refused(f"there is no `{text}` in {shown_folder(kind)}{did_you_mean(text, known)}")
    return folder / f"{text}.toml"


NAME = r"^\w[^/\x00-\x1f\x7f]*$"
"""Pattern of the name of a result, which is that of a folder or file."""

LONGEST = 100
"""Longest suffix of the name of a result or figure [characters]."""


def addition(text: str) -> str:
    """Return a suffix for the name of a result or figure; a long one is shortened and ends in a digest.

    >>> addition("--test2_half")
    '--test2_half'
    """
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST - 9]}{mark(text)}"


def file_name(text: str) -> str:
    """Return a text as part of a file's name; one with characters unsuited to it is altered and ends in a digest.

    >>> file_name("iRonCub-Mk1"), file_name("my robot")
    ('iRonCub-Mk1', 'my-robot~4320a9e0')
    """
    plain = re.sub(r"[^\w.+=-]", "-", text)
    return plain if plain == text else plain + mark(text)


def mark(text: str) -> str:
    """Return nine characters that distinguish texts with similar names."""
    return f"~{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of an error message that suggests words similar to `word`, or otherwise lists all known words.

    >>> did_you_mean("swep", ["sweep", "trim"])
    '; did you mean sweep?'
    """
    known = list(known)
    near = difflib.get_close_matches(word, known, n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(near)}?" if near else f"; there are {', '.join(known) or 'none'}"
