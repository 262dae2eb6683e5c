"""Write all results on one page: claims of the paper with our measurements and verdicts, runs, ablations, maps."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

import jax_aero
from experiments.report import judge, stored
from experiments.report.judge import Finding, Kind, Verdict, whole
from experiments.report.measures import files
from experiments.report.page import literal, markdown, to_html
from experiments.report.paper import OURS, Item, all_claims, all_items, sections
from experiments.report.results import Results
from jax_aero.base import places
from jax_aero.base.arguments import Parser, add_results
from jax_aero.base.files import write_text
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.results import manifest
from jax_aero.results.flight import PAPER_RUNS
from jax_aero.results.table import HEADINGS, outcome_row
from jax_aero.stored.outdated import ANOTHER

DOCS = places.HOME / "docs"
CLAIMS = DOCS / "claims.json"
GALLERY = "img/gallery"


def main(arguments: Sequence[str]) -> int:
    """Write the report from the results that exist."""
    parser = Parser("report", __doc__)
    add_results(parser)
    parser.add_argument(
        "--claims",
        type=Path,
        metavar="FILE",
        help="file of the claims of the documentation (default claims.json beside the report)",
    )
    parser.add_argument("--index", action="store_true", help="print the documentation's page: the paper, item by item")
    parser.add_argument(
        "--stale", action="store_true", help="use results of another configuration or numerics too, and mark them"
    )
    parser.add_argument("--check", action="store_true", help="status 1 if a verdict is not that of the documentation")
    given = parser.parse_args(arguments)

    def work() -> int:
        if given.index:
            print(index(), end="")
            return 0
        if not given.results.is_dir():
            raise Refused(f"`{given.results}` is no folder; expected one with results, as `jax-aero fly` makes it")
        results = Results(given.results, stale=given.stale)
        findings = {key: claim.find(results) for key, claim in all_claims().items()}
        measured = {
            key: findings[key] for key, claim in all_claims().items() if claim.commands and not claim.is_of_sweep
        }
        claims: Path = given.claims or results.folder / "claims.json"
        page = report(results, findings)
        for path, text in (
            (results.folder / "report.md", page),
            (results.folder / "report.html", to_html(page, results.folder)),
            (claims, judge.to_json(measured, claims)),
        ):
            write_text(path, text)
            print(path)
        failed = [key for key, finding in findings.items() if finding.verdict.kind is Kind.ERROR]
        for key in failed:
            print(f"{key}: {findings[key].verdict}", file=sys.stderr)
        for name, differs in results.refused.items():
            print(f"refused: {name} is {ANOTHER} ({differs})", file=sys.stderr)
        unlike = check(findings) if given.check else 0
        return int(bool(failed or results.refused) or unlike)

    return exit_status(work)


def check(findings: Mapping[str, Finding]) -> int:
    """Print the verdicts from results that are not the kept ones; return the exit status."""
    known, claims = documented(), all_claims()
    judged = [key for key, one in findings.items() if claims[key].commands and one.verdict.kind is not Kind.NOT_FLOWN]
    unlike = [key for key in judged if findings[key].verdict != known[key].verdict]
    for key in unlike:
        print(f"{key}: {findings[key].verdict}; the documentation has: {known[key].verdict}", file=sys.stderr)
    print(f"{len(judged) - len(unlike)} of {len(judged)} verdicts from results are those of the documentation")
    return int(bool(unlike))


# --- the report of a results folder ---------------------------------------------------------------------------------


def report(results: Results, findings: Mapping[str, Finding]) -> str:
    """Return the whole report: what was found, the runs that it rests on, then every claim and every sweep."""
    commit = manifest.git_state()["commit"]
    missing = [key for key, finding in findings.items() if finding.verdict.kind is Kind.NOT_FLOWN]
    unlike = (Kind.IN_PART, Kind.DIFFERS, Kind.ERROR)
    claims, flown = all_claims(), [name for name in results.flights if name not in results.refused]
    drawn = {item.figure: f"{item.name}: {item.shows}" for item in reversed(all_items()) if item.figure}
    swept = places.names("sweeps")
    return markdown(
        "report.md",
        version=f"jax-aero {jax_aero.__version__}" + (f", commit `{commit[:10]}`" if commit else ""),
        counted=count_verdicts(findings.values()),
        unlike=[_claim(key, finding) for key, finding in findings.items() if finding.verdict.kind in unlike],
        refused=list(results.refused.items()),
        another=ANOTHER,
        run_headings=HEADINGS,
        runs=[_run(results, name) for name in PAPER_RUNS if name in flown],
        others=[_run(results, name) for name in flown if name not in PAPER_RUNS],
        figures=pictures(results, ((name, drawn[name]) for name in reversed(drawn) if name not in swept)),
        claims=[
            (*_claim(key, finding), _origin(results, key)) for key, finding in findings.items() if key not in missing
        ],
        missing=[(claims[key].where, claims[key].states, _commands(key)) for key in missing],
        sweeps=[_sweep(results, name) for name in results.sweeps if f"sweep {name}" not in results.refused],
    )


def _claim(key: str, finding: Finding) -> tuple[str, str, str, str]:
    claim = all_claims()[key]
    return claim.where, claim.states, finding.measured, f"**{finding.verdict}**"


def _commands(key: str) -> str:
    commands = all_claims()[key].commands
    return f"`{'; '.join(whole(commands))}`" if commands else ""


def _origin(results: Results, key: str) -> str:
    """Return the figure that shows a claim, if it is drawn, and the commands that make its results."""
    figure = all_claims()[key].figure or next(item.figure for item in all_items() if key in item.claims)
    path = results.figures(figure).get("") if figure else None
    return " ".join(filter(None, (f"[{figure}]({path})" if path else "", _commands(key))))


def count_verdicts(findings: Collection[Finding]) -> str:
    """Return the number of claims with each kind of verdict."""
    return say_counts(Counter(finding.verdict.kind for finding in findings))


def say_counts(counts: Counter[Kind], what: str = "claims") -> str:
    """Return the number of claims, and of those with each kind of verdict."""
    words = {Kind.AGREES: "agree", Kind.IN_PART: "agree in part", Kind.DIFFERS: "differ"}
    words |= {kind: f"are {kind.value}" for kind in (Kind.OUT_OF_REACH, Kind.NOT_COMPARED)}
    said = ", ".join(f"**{counts[kind]}** {words.get(kind, kind.value)}" for kind in Kind if counts[kind])
    return f"Of {counts.total()} {what} {said}." if counts else "No claim was judged."


def _outdated(differs: str) -> str:
    return f" **{ANOTHER[0].upper()}{ANOTHER[1:]}: {differs}.**" if differs else ""


def _run(results: Results, name: str) -> Sequence[str]:
    document = results.flights[name].document
    _, *figures = outcome_row(document)
    return f"`{name}` {literal(document['title'])}{_outdated(results.differences[name])}", *figures


def pictures(results: Results, figures: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return path and caption of every picture of these figures, with the runs that it shows if they are others."""
    return [
        (path, f"{caption} (`{runs}`)" if runs else caption)
        for name, caption in figures
        for runs, path in results.figures(name).items()
    ]


def _sweep(results: Results, name: str) -> Mapping[str, object]:
    document = results.sweeps[name].document
    finished = document["finished"]["outcomes"]
    counted = ", ".join(
        f"{number} {outcome.replace('_', ' ')}"
        for outcome, number in finished.items()
        if outcome != "error" and (number or outcome in ("completed", "fell"))
    )
    failed = f", {finished['error']} could not be flown" if finished["error"] else ""
    return {
        "title": document["title"],
        "description": document["description"],
        "flown": f"{document['rows']} flights: {counted}{failed}.",
        "differs": _outdated(results.differences[f"sweep {name}"]),
        "figures": pictures(results, [(name, f"{literal(document['title'])} (`{name}`)")]),
    }


# --- the documentation's page of the paper --------------------------------------------------------------------------


def documented() -> dict[str, Finding]:
    """Return the finding of every claim: kept, outdated if it is of another claim or configuration, or from files."""
    known, swept, nothing = judge.read(CLAIMS), stored.findings(), Results(DOCS)
    findings = {}
    for key, claim in all_claims().items():
        if key in swept:
            findings[key] = swept[key]
        elif key not in known:
            findings[key] = claim.find(nothing)
        else:
            old = known[key]
            is_todays = old.identity == claim.identity
            if is_todays:
                _check(key, old)
            findings[key] = old if is_todays else replace(old, verdict=Verdict.of(Kind.OUTDATED, old.verdict.text))
    return findings


def _check(key: str, finding: Finding) -> None:
    """Refuse a stored finding that contradicts itself; seal it as one may."""
    try:
        all_claims()[key].check(finding)
    except (LookupError, Refused) as reason:
        raise Refused(f"{CLAIMS}: `{key}`: {reason}") from None


def verdicts(known: Mapping[str, Finding]) -> dict[str, Counter[Kind]]:
    """Return how many statements of the paper and how many of ours have which verdict.

    One that stands in several rows of the page is one.
    """
    counts: dict[str, Counter[Kind]] = {"statements of the paper": Counter(), "statements of ours": Counter()}
    of_paper, of_ours = counts.values()
    for title, items in sections().items():
        of_items = of_ours if title == OURS else of_paper
        of_items.update(Kind.of(item.verdict) for item in items if item.verdict)
    for key in dict.fromkeys(key for item in all_items() for key in item.claims):
        (of_ours if all_claims()[key].where == "ours" else of_paper).update([known[key].verdict.kind])
    return counts


def index() -> str:
    """Return the paper, item by item, as Markdown."""
    known = documented()
    rows = {title: [row for item in items for row in _rows(item, known)] for title, items in sections().items()}
    tables = {one.__name__: one() for one in (files.links, files.engines, files.coefficients, files.meshes)}
    counted = " ".join(say_counts(counts, what) for what, counts in verdicts(known).items())
    return markdown("paper.md", counted=counted, sections=rows, **tables)


def _rows(item: Item, known: Mapping[str, Finding]) -> Iterator[tuple[str, ...]]:
    ours = ", ".join([*([_figure(item.figure)] if item.figure else []), *map(_link, item.links)])
    command = "; ".join(f"`{word}`" for word in item.commands)
    stated = [(all_claims()[key].states, known[key].measured, str(known[key].verdict)) for key in item.claims]
    held = ", ".join(f"`{one}`" if one.startswith("tests/") else one for one in item.held_by)
    for number, row in enumerate(stated or [("", held, item.verdict)]):
        first = (f"{item.name}: {item.shows}", ours, command) if number == 0 else ("", "", "")
        yield (*first, *row)


def _figure(name: str) -> str:
    """Return a figure's name, linked to its picture in the gallery or on the page of its study if there is one."""
    drawn = [*(DOCS / GALLERY).glob(f"{name}.png"), *places.STUDIES.glob(f"*/{name}.png")]
    paths = [f"{GALLERY if DOCS in at.parents else f'studies/{at.parent.name}'}/{at.name}" for at in drawn]
    return f"[{name}]({paths[0]})" if paths else f"`{name}`"


def _link(link: str) -> str:
    if link.startswith("configs/"):
        return f"`{link}`"
    name = link.removeprefix("#").replace("-", " ") if link.startswith("#") else link.rsplit("#", 1)[-1]
    return f"[{name}]({link})"
