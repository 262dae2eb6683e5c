"""The page of each kept result."""

from __future__ import annotations

from collections.abc import Iterator

from experiments.report import stored
from experiments.report.page import markdown
from jax_aero.results import kept
from jax_aero.results.kept import Kept
from jax_aero.results.kept_tables import SHOWN, Rows, of_page, of_study


def pages() -> dict[str, str]:
    """Return the pages of all kept results by file name, and the page that lists them."""
    documents = [kept.read(name) for name in kept.names()]
    rows = [(f"[{one.name}]({one.name}.md)", one.title, _made(one)) for one in documents]
    return {"index.md": markdown("kept_index.md", rows=rows)} | {f"{one.name}.md": page(one) for one in documents}


def page(document: Kept) -> str:
    """Return the page of a kept result, as Markdown."""
    stated = stored.stated(document)
    ends = ", ".join(f"{number} {end.replace('_', ' ')}" for end, number in document.outcomes.items() if number)
    return markdown(
        "kept.md",
        kept=document,
        outcomes=f"{sum(document.outcomes.values())} flights ({document.each}): {ends}.",
        flown=of_page(document) if document.rows else None,
        legend=" ".join(_legend(document)),
        summary=list(_summary(document)),
        claims=[
            (stated[key].states, one.measured, f"**{one.verdict}**") for key, one in stored.claims(document).items()
        ],
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
    yield from (SHOWN[shown][1] for shown in document.shows)
    if document.outcomes.get("diverged"):
        yield f"Of those that fell {document.outcomes['diverged']} diverged."
    if document.pooled:
        yield f"Pooled over {', '.join(document.pooled)}."


def _summary(document: Kept) -> Iterator[str | Rows]:
    """Yield a text as it is, and figures as tables: one of plain ones, one for cases with the same figures."""
    if isinstance(document.summary, str):
        yield document.summary
        return
    by_figures: dict[tuple[str, ...], list[str]] = {}
    for case, figures in kept.cases_of(document.summary).items():
        by_figures.setdefault(tuple(figures) if case else (), []).append(case)
    for columns, cases in by_figures.items():
        headings, rows = of_study(document, list(columns), cases if columns else [], 4)
        if rows:
            yield headings, rows
