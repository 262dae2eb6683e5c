"""Kept results: the claims of sweeps, judged from the kept rows, and a page for each result."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from experiments.report import judge, paper
from experiments.report.judge import Finding, Kind, Verdict
from experiments.report.measures.results import of_cells
from experiments.report.page import markdown
from jax_aero.base import places
from jax_aero.stored import kept, outdated
from jax_aero.stored.kept import Kept
from jax_aero.stored.outdated import ANOTHER
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
    measured = of_cells(cells, [axis.name for axis in document.axes], asked)
    verdict = judge.of_sweep(document.name, asked).judge(measured.cases)
    if unknown := [
        column for column in asked.at_most if column.endswith(OF_ALL) and any(c[column] is None for c in cells)
    ]:
        verdict = Verdict.of(Kind.OUTDATED, f"`{unknown[0]}` is not kept: {kept.AGAIN}")
    if differs:
        if verdict.kind is not Kind.OUTDATED:
            verdict = Verdict.of(Kind.OUTDATED, verdict.text)
        return Finding(f"{measured.text}; {ANOTHER}: {differs}", verdict, document.commit)
    return Finding(measured.text, verdict, document.commit)


@cache
def _differs(result: str, digest: str, numerics: tuple[tuple[str, int], ...]) -> str:
    return outdated.sweep(places.RESULTS / result, {"config_digest": digest, "numerics": dict(numerics)})


# --- pages ------------------------------------------------------------------------------------------------------------


def pages() -> dict[str, str]:
    """Return the pages of all kept results by file name, and the page that lists them."""
    documents = [kept.read(name) for name in kept.names()]
    rows = [(f"[{one.name}]({one.name}.md)", one.title, _made(one)) for one in documents]
    return {"index.md": markdown("kept_index.md", rows=rows)} | {f"{one.name}.md": page(one) for one in documents}


def page(document: Kept) -> str:
    """Return the page of a kept result, as Markdown."""
    asked = stated(document)
    ends = ", ".join(f"{number} {end.replace('_', ' ')}" for end, number in document.outcomes.items() if number)
    return markdown(
        "kept.md",
        kept=document,
        outcomes=f"{sum(document.outcomes.values())} flights ({document.each}): {ends}.",
        flown=kept.page_table(document) if document.rows else None,
        legend=" ".join(_legend(document)),
        summary=list(_summary(document)),
        claims=[(asked[key].states, one.measured, f"**{one.verdict}**") for key, one in claims(document).items()],
        picture=f"{document.name}.webp" if document.is_drawn else "",
        made=_made(document),
        again=_again(document),
    )


def _again(document: Kept) -> str:
    if document.firsts and not any(document.firsts):
        return "On another processor its shares repeat within their intervals, its digits do not."
    return f"The first flight of each cell: {document.firsts_flown}." if document.firsts_flown else ""


def _made(document: Kept) -> str:
    commit = f", commit {document.commit[:10]}" if document.commit else ", of changed code"
    seed = "" if document.seed is None else f", seed {document.seed}"
    return f"{document.created[:10]}{commit}{seed}"


def _legend(document: Kept) -> Iterator[str]:
    yield from (kept.SHOWN[shown][1] for shown in document.shows)
    if document.outcomes.get("diverged"):
        yield f"Of those that fell {document.outcomes['diverged']} diverged."
    if document.pooled:
        yield f"Pooled over {', '.join(document.pooled)}."


def _summary(document: Kept) -> Iterator[str | kept.Rows]:
    """Yield a text as it is, and figures as tables: one of plain ones, one for cases with the same figures."""
    if isinstance(document.summary, str):
        yield document.summary
        return
    by_figures: dict[tuple[str, ...], list[str]] = {}
    for case, figures in kept.cases_of(document.summary).items():
        by_figures.setdefault(tuple(figures) if case else (), []).append(case)
    for columns, cases in by_figures.items():
        headings, rows = kept.study_table(document, list(columns), cases if columns else [], 4)
        if rows:
            yield headings, rows
