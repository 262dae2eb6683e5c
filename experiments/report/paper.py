"""The table of the paper: its figures, tables, equations and numbers, their claims, how each is measured, our verdict.

`paper.toml` is the only table, to which the claims in the files of sweeps are added; the report (`jax-aero report`) and
the documentation's page (`jax-aero report --index`) follow from it. Verdicts are computed (`judge`). Entries of studies
whose folders are not there are left out, and figures and sweeps that the table does not name are added to its end.
"""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from msgspec.structs import replace

from experiments.report.judge import Claim, Kind, each, of_sweep, whole
from jax_aero.base import places, tables
from jax_aero.commands import study as studies
from jax_aero.figures.catalogue import FIGURES, SWEEPS
from jax_aero.sweep.criteria import Criterion

OURS = "Beyond the paper"


class Item(tables.Table, frozen=True):
    """One item of the paper, or one of this project beyond it."""

    name: str
    shows: str = ""
    """If empty, the title of the figure or sweep."""
    figure: str = ""
    """Name of a figure or sweep of `paper_figs`."""
    links: tuple[str, ...] = ()
    """Pages of `docs`, and files of the repository."""
    verdict: str = ""
    """Our verdict, if nothing is measured: the word of its `Kind`, and what limits it."""
    held_by: tuple[str, ...] = ()
    """Tests that hold a verdict of agreement, or why it holds by construction."""
    made_by: tuple[str, ...] = ()
    """Commands that make it, without `jax-aero`, if not those of its claims or of its figure; without the drawing."""
    claims: tuple[str, ...] = ()
    """Keys of the claims of the rows below it."""

    @property
    def commands(self) -> list[str]:
        """Return the commands that make the item: its results first, then the figure."""
        made = whole(self.made_by or [command for key in self.claims for command in all_claims()[key].commands])
        if self.figure in FIGURES:
            made = made or FIGURES[self.figure].commands
        elif self.figure:
            made.append(f"jax-aero sweep {self.figure}")
        drawn = [f"jax-aero figures {self.figure}"] if self.figure else []
        return list(dict.fromkeys([*made, *drawn]))


class _Section(tables.Table, frozen=True):
    title: str
    item: tuple[Item, ...]


class _Paper(tables.Table, frozen=True):
    section: tuple[_Section, ...]
    claim: dict[str, Claim]


@cache
def _table() -> _Paper:
    return tables.load(Path(__file__).with_name("paper.toml"), _Paper)


@cache
def all_claims() -> dict[str, Claim]:
    """Return all claims by key: those of the table whose studies are there, then those in the files of sweeps."""
    claims = {key: claim for key, claim in _table().claim.items() if all(map(_is_here, claim.commands))}
    return claims | {claim.key: of_sweep(name, claim) for name in SWEEPS for claim in stated(name)}


class _Stated(tables.Table, frozen=True):
    claim: tuple[Criterion, ...] = ()


def stated(name: str) -> tuple[Criterion, ...]:
    """Return the claims in the file of a shipped sweep, without reading what its levels name."""
    path = places.find("sweeps", name)
    return tables.convert({"claim": tables.read(path).get("claim", [])}, _Stated, path.name).claim


@cache
def sections() -> Mapping[str, Sequence[Item]]:
    """Return the table without studies that are absent, with all other figures and sweeps as items beyond the paper."""
    items_of: dict[str, list[Item]] = {section.title: [] for section in _table().section}
    for section in _table().section:
        for item in section.item:
            claims = tuple(key for key in item.claims if key in all_claims())
            if item.figure in ("", *FIGURES, *SWEEPS) and (claims or not item.claims):
                made_by = tuple(filter(_is_here, item.made_by))
                shows = item.shows or _title(item.figure)
                items_of[section.title].append(replace(item, shows=shows, claims=claims, made_by=made_by))
    shown = {item.figure for items in items_of.values() for item in items}
    others = [
        name for name in (*(name for name in FIGURES if not FIGURES[name].is_of_any), *SWEEPS) if name not in shown
    ]
    items_of[OURS] += [Item("beyond", _title(name), name) for name in others]
    waiting = set(SWEEPS)
    for items in items_of.values():
        for place, item in enumerate(items):
            if item.figure in waiting:
                waiting.remove(item.figure)
                items[place] = replace(item, claims=(*item.claims, *(claim.key for claim in stated(item.figure))))
    return items_of


def all_items() -> list[Item]:
    """Return the items of all sections, in order."""
    return [item for items in sections().values() for item in items]


def commands(*, ours: bool) -> list[str]:
    """Return the commands that make what the table judges, each once; with `ours`, also what is beyond the paper.

    Every flight and every sweep is a command of its own. One that needs more than is shipped, data or OpenFOAM, becomes
    a comment.
    """
    every = [(title, item) for title, items in sections().items() for item in items]
    items = [item for title, item in every if ours or (title != OURS and not _is_out_of_reach(item))]
    return list(dict.fromkeys(command for item in items for command in _without_drawing(item.commands)))


def _is_out_of_reach(item: Item) -> bool:
    return not item.claims and item.verdict.startswith(Kind.OUT_OF_REACH.value)


def _without_drawing(commands: Sequence[str]) -> list[str]:
    """Return the commands without the drawing, as comments if they need what is not here."""
    made = [command for command in commands if not command.startswith("jax-aero figures")]
    lacks = "data" if any(command.startswith("jax-aero data import") for command in made) else ""
    if not shutil.which("simpleFoam") and any(command.startswith("jax-aero cfd") for command in made):
        lacks = "OpenFOAM"
    return [f"# needs {lacks} that is not here: {command}" for command in made] if lacks else each(made)


def _is_here(command: str) -> bool:
    word, *names = command.split()
    return word != "study" or names[0] in studies.names()


def _title(figure: str) -> str:
    """Return what a figure shows, or the title of a sweep."""
    if figure in FIGURES:
        return FIGURES[figure].shows
    title: str = tomllib.loads(places.find("sweeps", figure).read_text(encoding="utf-8"))["title"]
    return title
