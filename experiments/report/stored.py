"""Claims of the sweeps whose results are kept, judged from the kept rows."""

from __future__ import annotations

from functools import cache

from experiments.report import judge, paper
from experiments.report.judge import Finding, Kind, Verdict
from experiments.report.measures.results import of_cells
from jax_aero.base import places
from jax_aero.results import kept, outdated
from jax_aero.results.kept import Kept
from jax_aero.results.outdated import ANOTHER
from jax_aero.sweep.criteria import Criterion
from jax_aero.sweep.populations import OF_ALL


def stated(document: Kept) -> dict[str, Criterion]:
    """Return the claims in the file of a kept sweep, by key."""
    _, _, name = document.result.partition("/")
    return {one.key: one for one in paper.stated(name)} if document.rows and name in places.names("sweeps") else {}


def claims(document: Kept) -> dict[str, Finding]:
    """Return what the rows say of these claims, by today's judge; outdated if the sweep is another by now."""
    asked = stated(document)
    differs = _differs(document.result, document.digest, tuple(document.numerics.items())) if asked else ""
    return {key: _find(document, one, differs) for key, one in asked.items()}


def findings() -> dict[str, Finding]:
    """Return the findings of all claims of kept sweeps."""
    return {key: finding for name in kept.names() for key, finding in claims(kept.read(name)).items()}


def _find(document: Kept, asked: Criterion, differs: str) -> Finding:
    twice = {document.paired} - {"", *asked.cells}  # a flight of pairs is in two rows
    cells = [cell for cell in document.cells(twice if asked.share else frozenset()) if asked.covers(cell)]
    found = of_cells(cells, [axis.name for axis in document.axes], asked)
    verdict = judge.of_sweep(document.name, asked).judge(found.cases)
    if unknown := [
        column for column in asked.at_most if column.endswith(OF_ALL) and any(c[column] is None for c in cells)
    ]:
        verdict = Verdict.of(Kind.OUTDATED, f"`{unknown[0]}` is not kept: {kept.AGAIN}")
    if differs:
        return Finding(f"{found.text}; {ANOTHER}: {differs}", Verdict.of(Kind.OUTDATED, verdict.text), document.commit)
    return Finding(found.text, verdict, document.commit)


@cache
def _differs(result: str, digest: str, numerics: tuple[tuple[str, int], ...]) -> str:
    return outdated.sweep(places.RESULTS / result, {"config_digest": digest, "numerics": dict(numerics)})
