"""Write all results on one page: claims of the paper with our measurements and verdicts, runs, ablations, maps."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import jax_aero
from experiments import Refused, manifest
from experiments.flight import PAPER_RUNS
from experiments.report import findings, paper_page
from experiments.report.findings import ANOTHER, Finding, Kind
from experiments.report.judges.results import answer
from experiments.report.page import Contents, Heading, Mark, Page, Picture, Table, Text, literal
from experiments.report.paper import all_claims, all_items, whole
from experiments.report.results import NotFlownError, Results, Sweep, count
from jax_aero.base import places
from jax_aero.base.files import write_text
from jax_aero.base.terminal import exit_status
from jax_aero.cli import Parser

PARTS = {
    "The paper's runs, perturbed": ("paper_tests", "model_pairs"),
    "Ablation of the aerodynamic feedback": ("ablation_",),
    "Where the baseline fails, and maps": ("baseline_edge", "map_"),
    "Jets and faults": ("jet_",),
    "Uncertainty": ("sensitivity",),
    "Controllers, faults and robots of our own": ("",),
}
"""Parts of the page and the beginnings of the names of their sweeps; each sweep belongs to the first that fits."""


def main(arguments: Sequence[str]) -> int:
    """Write the report from the results that exist."""
    parser = Parser("report", __doc__)
    parser.add_argument(
        "--results",
        type=Path,
        default=places.RESULTS,
        metavar="DIR",
        help="folder with flight/, sweeps/",
    )
    parser.add_argument(
        "--claims",
        type=Path,
        metavar="FILE",
        help="file of the claims of the documentation (default claims.json beside the report)",
    )
    parser.add_argument("--index", action="store_true", help="print the documentation's page: the paper, item by item")
    parser.add_argument(
        "--stale", action="store_true", help="use results of another configuration or code too, and mark them"
    )
    parser.add_argument("--check", action="store_true", help="status 1 if a verdict is not that of the documentation")
    given = parser.parse_args(arguments)

    def work() -> int:
        if (given.index or given.check) and not places.IS_CHECKOUT:
            option = "--index" if given.index else "--check"
            raise Refused(f"{option} reads docs/ of a checkout of the repository, and this is none")
        if given.index:
            print(paper_page.page(), end="")
            return 0
        if not given.results.is_dir():
            raise Refused(f"`{given.results}` is no folder; expected one with results, as `jax-aero fly` makes it")
        results = Results(given.results, stale=given.stale)
        found = {key: claim.find(results) for key, claim in all_claims().items()}
        measured = {key: found[key] for key, claim in all_claims().items() if claim.commands and not claim.is_of_sweep}
        kept: Path = given.claims or results.folder / "claims.json"
        page = build(results, found)
        for path, text in (
            (results.folder / "report.md", page.markdown()),
            (results.folder / "report.html", page.html(results.folder)),
            (kept, findings.to_json(measured, kept)),
        ):
            write_text(path, text)
            print(path)
        failed = [key for key, finding in found.items() if finding.verdict.kind is Kind.ERROR]
        for key in failed:
            print(f"{key}: {found[key].verdict}", file=sys.stderr)
        for name, differs in results.refused.items():
            print(f"refused: {name} is {ANOTHER} ({differs})", file=sys.stderr)
        unlike = _check(found) if given.check else 0
        return int(bool(failed or results.refused) or unlike)

    return exit_status(work)


def _check(found: Mapping[str, Finding]) -> int:
    """Print the verdicts from results that are not the kept ones; return the exit status."""
    kept, claims = paper_page.found(), all_claims()
    judged = [key for key, one in found.items() if claims[key].commands and one.verdict.kind is not Kind.NOT_FLOWN]
    unlike = [key for key in judged if found[key].verdict != kept[key].verdict]
    for key in unlike:
        print(f"{key}: {found[key].verdict}; the documentation has: {kept[key].verdict}", file=sys.stderr)
    print(f"{len(judged) - len(unlike)} of {len(judged)} verdicts from results are those of the documentation")
    return int(bool(unlike))


def build(results: Results, found: Mapping[str, Finding]) -> Page:
    """Return the whole report: what was found, the runs it rests on, then every claim and every sweep."""
    page = Page("What flies, and why")
    commit = manifest.git_state()["commit"]
    version = f"jax-aero {jax_aero.__version__}" + (f", commit `{commit[:10]}`" if commit else "")
    page.add(
        Text(
            "The flight of the jet-powered humanoid iRonCub in wind, as published by Paolino et al. in *Communications "
            f"Engineering* (2025), flown again by {version}: what the paper says, what was measured here, and why."
        ),
        Contents(),
        Heading(2, "The answer"),
        Text(_compare(results)),
        Text(_count_verdicts(found.values())),
    )
    kinds = {key: finding.verdict.kind for key, finding in found.items()}
    unlike = [key for key in found if kinds[key] in (Kind.IN_PART, Kind.DIFFERS, Kind.ERROR)]
    if unlike:
        page.add(
            Text("What does not agree, or only in part:"),
            Table(
                ("where", "claim", "measured", "verdict"),
                [_claim(key, found[key]) for key in unlike],
            ),
        )
    if results.refused:
        page.add(
            Text(f"Refused, since {ANOTHER}; `make reproduce` makes them again, `report --stale` marks them:"),
            Table(("result", "difference"), list(results.refused.items())),
        )
    _minimum(page, results)
    _runs(page, results)
    _claims(page, results, found)
    waiting = dict(results.sweeps)
    for title, names in PARTS.items():
        chosen = {name: waiting.pop(name) for name in list(waiting) if name.startswith(names)}
        if chosen:
            page.add(Heading(2, title))
        for name, sweep in chosen.items():
            _sweep(page, results, name, sweep)
    page.add(
        Heading(2, "How to read and repeat this"),
        Text(
            "A count such as 39 of 40 (87 to 100 %) carries its Wilson 95 % interval: the flights behind it differ in "
            "start, wind and coefficients (`configs/perturbation/flight.toml`). *Corrected arms* place forces where "
            "physics has them, *published arms* where the published code has them (`docs/deviations.md`). "
            "`make reproduce SWEEPS=--all` makes all of this page from nothing."
        ),
    )
    return page


def _compare(results: Results) -> str:
    """Return how TEST2, with aerodynamic feedback, and TEST1, without it, ended."""
    said = []
    for arms, suffix in (("corrected", ""), ("published", "_published")):
        flights = [results.flights.get(name + suffix) for name in ("test2", "test1")]
        ended = [
            f"{flight.ending.partition(' (')[0]}, with a rotation error of at most **{flight.rotation_error:.1f}°**"
            for flight in flights
            if flight
        ]
        if len(ended) == len(flights):
            said.append(f"With {arms} lever arms the aerodynamic-aware controller {ended[0]}; the baseline {ended[1]}.")
    if said:
        said.insert(0, "The paper's mission in its side wind, TEST2 and TEST1.")
    return " ".join(said) or "The paper's flights TEST1 and TEST2 are not among the results."


def _claims(page: Page, results: Results, found: Mapping[str, Finding]) -> None:
    """Add all claims that were judged, then those for which results are missing, with the commands that make them."""
    claims = all_claims()
    figures = {key: claims[key].figure or item.figure for item in reversed(all_items()) for key in item.claims}
    missing = [key for key, finding in found.items() if finding.verdict.kind is Kind.NOT_FLOWN]
    page.add(
        Heading(2, "Claims"),
        Table(
            ("where", "claim", "measured", "verdict", "from"),
            [
                (*_claim(key, finding), " ".join(filter(None, (_link_figure(results, figures[key]), _commands(key)))))
                for key, finding in found.items()
                if key not in missing
            ],
        ),
    )
    if missing:
        page.add(
            Heading(3, "Not flown here"),
            Table(
                ("where", "claim", "command"),
                [(claims[key].where, claims[key].states, _commands(key)) for key in missing],
            ),
        )


def _claim(key: str, finding: Finding) -> tuple[str, str, str, Mark]:
    claim = all_claims()[key]
    return claim.where, claim.states, finding.measured, Mark(str(finding.verdict), finding.verdict.tone)


def _commands(key: str) -> str:
    commands = all_claims()[key].commands
    return f"`{'; '.join(whole(commands))}`" if commands else ""


def _count_verdicts(found: Collection[Finding]) -> str:
    """Return the number of claims with each kind of verdict."""
    counts = Counter(finding.verdict.kind for finding in found)
    words = {Kind.AGREES: "agree", Kind.IN_PART: "agree in part", Kind.DIFFERS: "differ"}
    said = ", ".join(f"**{counts[kind]}** {words.get(kind, kind.value)}" for kind in Kind if counts[kind])
    return f"Of {len(found)} claims {said}." if found else "No claim was judged."


def _link_figure(results: Results, figure: str) -> str:
    path = results.figures(figure).get("") if figure else None
    return f"[{figure}]({path})" if path else ""


def _minimum(page: Page, results: Results) -> None:
    try:
        sweep, least = results.sweep("ablation_terms"), answer(results)
    except (NotFlownError, KeyError):
        return
    worlds = sweep.levels("world")
    rows = [
        [
            feedback,
            *(
                f"{count(cell)}; {cell['on_course']} on course; {cell['rotation_error_deg_median']:.0f}°"
                for cell in (sweep.cell(world=world, feedback=feedback) for world in worlds)
            ),
        ]
        for feedback in sweep.levels("feedback")
    ]
    page.add(
        Heading(2, "The minimum aerodynamic information that still flies"),
        Text(least + _mark_outdated(sweep.differs)),
        Text(
            "Per world: flights completed, flights that also stayed within 15° and 0.25 m of their set-point, "
            "median of the greatest rotation error."
        ),
        Table(("feedback", *worlds), rows),
    )


def _runs(page: Page, results: Results) -> None:
    page.add(Heading(2, "The paper's runs"))
    headings = (
        "run",
        "outcome",
        "CoM error [cm]",
        "rotation error [deg]",
        "joint error sums, max: torso, arms l/r, legs l/r [deg]",
        "thrusts [N]",
        "left–right, max: arms, chest [N]",
        "total force, max [N]",
        "simulator − controller, max [N]",
    )
    named = PAPER_RUNS
    page.add(
        Text("The network is ours: the paper's weights are not public. Its card says what it was trained on."),
        Table(headings, [_run(results, name) for name in named if name in results.flights]),
    )
    swept = places.names("sweeps")
    captions = {item.figure: f"{item.name}: {item.shows}" for item in reversed(all_items())}
    figures = [(name, caption) for name, caption in reversed(captions.items()) if name and name not in swept]
    page.add(*_pictures(results, figures))
    others = sorted(set(results.flights) - set(named))
    if others:
        page.add(
            Heading(2, "Runs of our own"),
            Text("Not in the paper: other controllers, missions, engines and robots."),
            Table(headings, [_run(results, name) for name in others]),
        )


def _mark_outdated(differs: str) -> str:
    return f" **{ANOTHER[0].upper()}{ANOTHER[1:]}: {differs}.**" if differs else ""


def _run(results: Results, name: str) -> Sequence[str]:
    flight = results.flights[name]
    return (
        f"`{flight.name}` {literal(flight.title)}{_mark_outdated(results.differences[name])}",
        flight.ending,
        "–" if math.isnan(flight.com_error) else f"{100.0 * flight.com_error:.1f}",
        f"{flight.rotation_error:.1f}",
        ", ".join(f"{error:.0f}" for error in flight.joint_errors.values()),
        f"{flight.thrust[0]:.1f} to {flight.thrust[1]:.1f}",
        f"{flight.asymmetry[0]:.1f}, {flight.asymmetry[1]:.1f}",
        f"{flight.force:.1f}",
        f"{flight.force_difference:.1f}",
    )


def _pictures(results: Results, figures: Iterable[tuple[str, str]]) -> list[Picture]:
    return [
        Picture(path, f"{caption} (`{runs}`)" if runs else caption)
        for name, caption in figures
        for runs, path in results.figures(name).items()
    ]


def _sweep(page: Page, results: Results, name: str, sweep: Sweep) -> None:
    document = sweep.document
    finished, title = document["finished"]["outcomes"], literal(document["title"])
    counted = ", ".join(
        f"{number} {outcome.replace('_', ' ')}"
        for outcome, number in finished.items()
        if outcome != "error" and (number or outcome in ("completed", "fell"))
    )
    failed = f", {finished['error']} could not be flown" if finished["error"] else ""
    page.add(
        Heading(3, title),
        Text(
            f"{literal(document['description'])} {document['rows']} flights: {counted}{failed}.".strip()
            + _mark_outdated(sweep.differs)
        ),
    )
    page.add(*_pictures(results, [(name, f"{title} (`{name}`)")]))
