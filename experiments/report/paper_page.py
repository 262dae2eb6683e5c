"""The documentation's page of the paper, item by item: the table with findings that are kept or follow from files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from experiments.report import findings, kept
from experiments.report.findings import Finding
from experiments.report.judges import files
from experiments.report.page import Heading, Page, Table, Text
from experiments.report.paper import Item, all_claims, sections
from experiments.report.results import Results
from jax_aero.base import places

DOCS = places.HOME / "docs"
CLAIMS = DOCS / "claims.json"
GALLERY = "img/gallery"
HEADINGS = ("item", "ours", "command", "paper", "measured", "verdict")
ABOUT = (
    "This page compares every figure, table, equation and claim of the paper with what we measured. A verdict is "
    "*agrees*, *differs* (with the difference), *not compared* or *out of reach* (with the reason). What agrees "
    "without a measurement names the test that holds it. [Deviations](deviations.md) explains the differences. "
    "`jax-aero report --index` makes this page: what follows from committed files alone is computed, and "
    "`jax-aero report --claims docs/claims.json` stores the other measurements with their commit."
)
TABLES = {
    "The robot": (
        files.robot_table,
        "Aerodynamic links, for Fig. 1 and Suppl. Fig. 6: `configs/robot/ironcub_mk1.toml`.",
    ),
    "Suppl. Table 1": (files.engine_table, "Identified engines, with their steady-state thrusts."),
    "Suppl. Table 2": (files.coefficient_table, "Force areas [m²] as published, and refitted to the public table."),
    "Suppl. Table 3": (
        files.mesh_table,
        "Meshes of flight30 in the public records; sizing parameters are not public.",
    ),
}
"""Tables by title; the first row holds the headings."""


def found() -> dict[str, Finding]:
    """Return the finding of every claim: kept, from files, or that it is not flown here."""
    known, nothing = findings.read(CLAIMS) | kept.findings(), Results(DOCS)
    return {key: known[key] if key in known else claim.find(nothing) for key, claim in all_claims().items()}


def page() -> str:
    """Return the page as Markdown."""
    known, shown = found(), Page("The paper, item by item", [Text(ABOUT)])
    for title, items in sections().items():
        shown.add(Heading(2, title), Table(HEADINGS, [row for item in items for row in _rows(item, known)]))
    for title, (rows, caption) in TABLES.items():
        headings, *rest = rows()
        shown.add(Heading(2, title), Text(caption), Table(headings, rest))
    return shown.markdown()


def _rows(item: Item, known: Mapping[str, Finding]) -> Iterator[tuple[str, ...]]:
    ours = ", ".join([*([_figure(item.figure)] if item.figure else []), *map(_link, item.links)])
    command = "; ".join(f"`{word}`" for word in item.commands)
    stated = [(all_claims()[key].states, known[key].measured, str(known[key].verdict)) for key in item.claims]
    for number, row in enumerate(stated or [("", _held_by(item), item.verdict)]):
        first = (f"{item.name}: {item.shows}", ours, command) if number == 0 else ("", "", "")
        yield (*first, *row)


def _held_by(item: Item) -> str:
    """Return the tests that hold the verdict on an item for which nothing is measured, or why it holds without."""
    return ", ".join(f"`{one}`" if one.startswith("tests/") else one for one in item.held_by)


def _figure(name: str) -> str:
    """Return a figure's name, linked to its picture in the gallery or on the page of its study if there is one."""
    pictures = [*(DOCS / GALLERY).glob(f"{name}.png"), *places.STUDIES.glob(f"*/{name}.png")]
    paths = [f"{GALLERY if DOCS in at.parents else f'studies/{at.parent.name}'}/{at.name}" for at in pictures]
    return f"[{name}]({paths[0]})" if paths else f"`{name}`"


def _link(link: str) -> str:
    if link.startswith("configs/"):
        return f"`{link}`"
    name = link.removeprefix("#").replace("-", " ") if link.startswith("#") else link.rsplit("#", 1)[-1]
    return f"[{name}]({link})"
