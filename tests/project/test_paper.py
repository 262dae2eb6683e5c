"""The page of the paper: every figure has an item, what an item names exists, and figures are those of the files."""

import json
import re
import string
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from experiments.report import command as report
from experiments.report import judge, paper, stored
from experiments.report.command import CLAIMS as KEPT_CLAIMS
from experiments.report.command import documented, index
from experiments.report.judge import Kind
from experiments.report.results import Results
from jax_aero.base.terminal import Refused
from jax_aero.cli import COMMANDS, main
from jax_aero.commands import study as studies
from jax_aero.commands.fly import main as fly
from jax_aero.figures.catalogue import FIGURES, OURS, PAPER, SWEEPS

ROOT = Path(__file__).resolve().parents[2]
KEPT = judge.read(KEPT_CLAIMS) | stored.findings()
CLAIMS = paper.all_claims()
ITEMS = paper.all_items()


def anchors(page: str) -> set[str]:
    """What a page can be linked at: its headings, as the site spells them."""
    headings = re.findall(r"^#+ (.+)$", page, re.M)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading.lower())).strip("-") for heading in headings}


def test_the_index_is_the_page(capsys):
    assert main(["report", "--index"]) == 0
    assert capsys.readouterr().out == index()


def test_every_figure_and_sweep_has_an_item():
    drawn = {name for name, entry in FIGURES.items() if not entry.is_of_any}
    assert {item.figure for item in ITEMS} - {""} == {*drawn, *SWEEPS}


def test_every_claim_is_that_of_an_item():
    assert {key for item in ITEMS for key in item.claims} == set(CLAIMS)


def test_what_needs_results_is_kept_with_a_verdict_and_nothing_else_is():
    assert set(KEPT) == {key for key, claim in CLAIMS.items() if claim.commands}
    found = documented()
    outdated = {key for key, finding in found.items() if finding.verdict.kind is Kind.OUTDATED}
    to_fly = {key for key, finding in stored.findings().items() if finding.verdict.kind is Kind.OUTDATED}
    of_sweeps = {key for key, claim in CLAIMS.items() if claim.is_of_sweep} - stored.findings().keys()
    assert outdated == of_sweeps | to_fly
    assert {found[key].verdict.kind for key in found.keys() - outdated} <= {
        Kind.AGREES, Kind.IN_PART, Kind.DIFFERS, Kind.OUT_OF_REACH, Kind.NOT_COMPARED,
    }  # fmt: skip


def test_a_stored_verdict_is_of_its_claim_and_of_its_results(monkeypatch):
    """Another bound, or another configuration of a flight, and it is outdated."""
    claim = CLAIMS["aligned"]
    (bound,) = claim.asks
    other = replace(claim, asks=(replace(bound, below=1500.0),))
    monkeypatch.setattr(report, "all_claims", lambda: {"aligned": other})
    assert documented()["aligned"].verdict.kind is Kind.OUTDATED
    monkeypatch.setattr(report, "all_claims", lambda: {"aligned": claim})
    assert documented()["aligned"].verdict.kind is Kind.AGREES
    monkeypatch.setattr(judge.rust, "config_digest", lambda _: "of c0 = 5")
    judge._today.cache_clear()
    assert documented()["aligned"].verdict.kind is Kind.OUTDATED
    judge._today.cache_clear()


def claims_file(tmp_path, change, *, sealed):
    """A file of claims as it is kept, with this change of its claims, and a seal of it all if it is `sealed`."""
    document = json.loads(KEPT_CLAIMS.read_text(encoding="utf-8"))
    change(document["claims"])
    if sealed:
        document["seal"] = judge.seal_of(msgspec.convert(document, judge.Record).claims)
    path = tmp_path / "claims.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_an_edited_file_of_claims_is_refused(tmp_path):
    """Three verdicts that are set to "agrees", and a count."""

    def set_verdicts(claims):
        for key in ("fuel_flown", "oscillations", "signs"):
            claims[key]["verdict"] = {"kind": "agrees", "text": "agrees"}

    def set_count(claims):
        claims["test1"]["measured"] = claims["test1"]["measured"].replace("242 of 250", "249 of 250")

    assert judge.read(claims_file(tmp_path, lambda _: None, sealed=False)) == judge.read(KEPT_CLAIMS)
    for change in (set_verdicts, set_count):
        with pytest.raises(Refused, match="is not what was written there"):
            judge.read(claims_file(tmp_path, change, sealed=False))


SEALED = judge.read(KEPT_CLAIMS)


def printed(claim):
    """The numbers and words by case that the text of a claim has."""
    return {name for text in (claim.says, claim.before) for _, name, *_ in string.Formatter().parse(text) if name}


@pytest.mark.parametrize("key", SEALED)
def test_a_sealed_claim_that_contradicts_itself_is_refused(key, monkeypatch):
    """Another verdict, another text, or any one number or word that is in the text, whether or not it decides."""
    claim, finding = CLAIMS[key], SEALED[key]
    claim.check(finding)
    kind = Kind.DIFFERS if finding.verdict.kind is Kind.AGREES else Kind.AGREES
    wrong = [replace(finding, verdict=judge.Verdict.of(kind)), replace(finding, measured=f"{finding.measured}.")]
    for case, values in finding.cases.items():
        for name in printed(claim) & values.keys():
            other = "another" if isinstance(values[name], str) else 3.0 * values[name] + 1000.0
            is_said = name in claim.says or case == next(iter(finding.cases))
            if is_said:
                wrong.append(replace(finding, cases={**finding.cases, case: {**values, name: other}}))
    assert len(wrong) > 2
    for one in wrong:
        with pytest.raises(Refused, match="contradict the numbers beside them"):
            claim.check(one)
    monkeypatch.setattr(report.judge, "read", lambda _: SEALED | {key: wrong[0]})
    with pytest.raises(Refused, match=f"`{key}`"):
        documented()


def test_the_page_begins_with_the_sum_of_its_verdicts():
    """Each statement once, however many rows it is in; those of the paper and ours apart."""
    known = documented()
    of_paper, of_ours = report.verdicts(known).values()
    stated = {key for key, claim in CLAIMS.items() if claim.where != "ours"}
    whole = [item for title, items in paper.sections().items() if title != paper.OURS for item in items]
    assert of_paper.total() == len(stated) + sum(bool(item.verdict) for item in whole)
    assert of_ours.total() == len(CLAIMS) - len(stated)
    assert of_paper[Kind.DIFFERS] == sum(known[key].verdict.kind is Kind.DIFFERS for key in stated) + sum(
        item.verdict.startswith("differs") for item in whole
    )
    _, _, line, *_ = index().splitlines()
    assert line.startswith(f"Of {of_paper.total()} statements of the paper **{of_paper[Kind.AGREES]}** agree, ")


def test_a_finding_is_kept_once():
    assert not judge.read(KEPT_CLAIMS).keys() & stored.findings().keys()


def test_every_item_of_the_paper_has_a_verdict():
    for title, items in paper.sections().items():
        for item in items:
            judged = bool(item.claims) + bool(item.verdict)
            assert judged == 1 or (title == "Beyond the paper" and not item.verdict), item.name
            out_of_reach = item.verdict.startswith((Kind.OUT_OF_REACH.value, Kind.NOT_COMPARED.value))
            assert item.figure or item.links or item.claims or out_of_reach, item.name


def test_what_agrees_without_a_measurement_names_the_test_that_holds_it():
    for item in ITEMS:
        agrees = item.verdict.startswith(Kind.AGREES.value)
        assert agrees == bool(item.held_by), item.name
        for named in item.held_by:
            if named.startswith("tests/"):
                path, _, function = named.partition("::")
                assert f"\ndef {function}(" in (ROOT / path).read_text(encoding="utf-8"), named
            else:
                assert named.startswith("by construction: "), named


@pytest.mark.slow
def test_without_studies_nothing_of_the_table_names_one(monkeypatch):
    """As if the folders of all studies were deleted: figures of studies are not there either."""
    monkeypatch.setattr(studies, "names", list)
    monkeypatch.setattr(paper, "FIGURES", {name: FIGURES[name] for name in PAPER | OURS})
    monkeypatch.setattr(paper, "all_claims", paper.all_claims.__wrapped__)
    sections = paper.sections.__wrapped__()
    commands = [command for items in sections.values() for item in items for command in item.commands]
    assert not [command for command in commands if command.startswith("jax-aero study")]
    shown = {item.figure for items in sections.values() for item in items} - {""}
    assert shown == {*(name for name, entry in (PAPER | OURS).items() if not entry.is_of_any), *SWEEPS}
    (battery,) = [item for item in sections["Numbers of the text"] if item.shows == "battery against fuel"]
    assert battery.claims == ("battery", "fuel")


@pytest.mark.parametrize("link", sorted({link for item in ITEMS for link in item.links}))
def test_links_lead_somewhere(link):
    path, _, anchor = link.partition("#")
    if path.startswith("configs/"):
        assert (ROOT / path).is_file()
    elif re.fullmatch(r"m\d+", anchor):
        assert rf"\tag{{{anchor.upper()}}}" in (ROOT / "docs" / path).read_text(encoding="utf-8")
    else:
        page = ROOT / "docs" / path
        assert not path or page.is_file()
        assert not anchor or anchor in anchors(page.read_text(encoding="utf-8") if path else index())


def test_what_reproduces_the_paper_makes_what_every_claim_needs(monkeypatch):
    monkeypatch.setattr(paper.shutil, "which", lambda _: "simpleFoam")
    made = [command for command in paper.commands(ours=False) if not command.startswith("#")]
    needed = {key: paper.each(claim.commands) for key, claim in CLAIMS.items() if claim.where != "ours"}
    asked = {command for commands in needed.values() for command in commands}
    assert asked <= set(made)
    beyond = {f"jax-aero sweep {item.figure}" for item in paper.sections()[paper.OURS]}
    assert not (beyond - asked) & set(made)
    assert set(made) < set(paper.commands(ours=True))


def test_what_is_not_here_is_named_and_not_asked_for(monkeypatch):
    monkeypatch.setattr(paper.shutil, "which", lambda _: None)
    commands = paper.commands(ours=True)
    assert "# needs OpenFOAM that is not here: jax-aero cfd flow flight30" in commands
    assert not [command for command in commands if command.startswith(("jax-aero cfd", "jax-aero data import"))]


def test_commands_name_what_exists():
    experiments = {path.stem for path in (ROOT / "configs/experiments").glob("*.toml")}
    for item in ITEMS:
        for command in item.commands:
            program, first, *rest = command.split()
            assert program == "jax-aero"
            assert first in COMMANDS, command
            if first == "figures":
                assert rest == [item.figure]
            elif first == "fly":
                assert rest, command
                assert set(rest) <= experiments, command
            elif first == "sweep":
                assert all((ROOT / f"configs/sweeps/{name}.toml").is_file() for name in rest)
            elif first == "study":
                assert rest[0] in studies.names(), command
                assert rest[0] != "trim" or rest[2:] == ["--map"], command  # without --map it leaves no result


@pytest.mark.slow
def test_claims_of_single_flights_are_those_of_the_code(tmp_path, capsys):
    """The crate computes the same bits everywhere, so what it flew once it flies again."""
    alone = {key: one for key, one in CLAIMS.items() if [command.split()[0] for command in one.commands] == ["fly"]}
    # MuJoCo's ground is slower.
    flown = {key: claim for key, claim in alone.items() if "balancing" not in claim.commands[0]}
    names = sorted({name for claim in flown.values() for name in claim.commands[0].split()[1:]})
    assert fly([*names, "--out", str(tmp_path / "flight")]) == 0
    capsys.readouterr()
    results = Results(tmp_path)
    for key, claim in flown.items():
        kept = KEPT[key]
        assert claim.decide(results) == (kept.measured, kept.verdict), key
