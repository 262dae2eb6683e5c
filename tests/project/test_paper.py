"""The page of the paper: every figure has an item, what an item names exists, and figures are those of the files."""

import dataclasses
import re
import subprocess
from pathlib import Path

import pytest

from experiments import studies
from experiments.fly import main as fly
from experiments.report import claims, facts
from experiments.report.results import Results
from experiments.report.verdicts import NOT_FLOWN
from jax_aero.cli import COMMANDS
from paper_figs import paper
from paper_figs.command import main
from paper_figs.figures import FIGURES, SWEEPS

ROOT = Path(__file__).resolve().parents[2]
RECORD = paper.read_record()
SECTIONS = paper.sections(RECORD["claims"])
ITEMS = [item for items in SECTIONS.values() for item in items]
WORDS = ("agrees", "differs: ", "out of reach: ", NOT_FLOWN)
MODEL = (ROOT / "docs/model.md").read_text(encoding="utf-8")


def anchors(page: str) -> set[str]:
    """What a page can be linked at: its headings, as the site spells them."""
    headings = re.findall(r"^#+ (.+)$", page, re.M)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading.lower())).strip("-") for heading in headings}


def test_the_index_is_the_page(capsys):
    assert main(["--index"]) == 0
    assert capsys.readouterr().out == paper.page()


def test_every_figure_and_sweep_has_an_item():
    shown = {item.figure for item in ITEMS} - {""}
    assert set(FIGURES) | set(SWEEPS) <= shown
    assert shown <= {*FIGURES, *(path.stem for path in (ROOT / "configs/sweeps").glob("*.toml"))}


def test_every_claim_is_shown_and_has_a_verdict():
    used = {key for item in ITEMS for key in item.claims}
    assert used == set(RECORD["claims"]) == {claim.key for claim in claims.CLAIMS}
    for claim in RECORD["claims"].values():
        assert claim["verdict"].startswith(WORDS), claim


def test_every_item_of_the_paper_has_a_verdict():
    for title, items in SECTIONS.items():
        for item in items:
            judged = bool(item.claims or item.tunnel) + bool(item.verdict)
            assert judged == 1 or (title == "Beyond the paper" and not item.verdict), item.name
            assert not item.verdict or item.verdict.startswith(WORDS), item.name
            assert item.figure or item.links or item.claims or item.verdict.startswith("out of reach"), item.name


@pytest.mark.parametrize("link", sorted({link for item in ITEMS for link in item.links}))
def test_links_lead_somewhere(link):
    path, _, anchor = link.partition("#")
    if path.startswith("configs/"):
        assert (ROOT / path).is_file()
    elif re.fullmatch(r"m\d+", anchor):
        assert rf"\tag{{{anchor.upper()}}}" in MODEL
    else:
        page = ROOT / "docs" / path
        assert not path or page.is_file()
        assert not anchor or anchor in anchors(page.read_text(encoding="utf-8") if path else paper.page())


def test_commands_name_what_exists():
    experiments = {path.stem for path in (ROOT / "configs/experiments").glob("*.toml")}
    for item in ITEMS:
        for command in paper.command_of(item, RECORD["claims"]).split("; "):
            if not command:
                continue
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


def test_claims_of_single_flights_are_those_of_the_code(tmp_path, capsys):
    """The crate computes the same bits everywhere, so what it flew once it flies again."""
    alone = [claim for claim in claims.CLAIMS if claim.flights and not claim.sweep and not claim.study]
    flown = [claim for claim in alone if not claim.flights[0].startswith("balancing")]  # MuJoCo's ground is slower
    names = sorted({name for claim in flown for name in claim.flights})
    assert fly([*names, "--out", str(tmp_path / "flight")]) == 0
    capsys.readouterr()
    results = Results(tmp_path)
    for claim in flown:
        kept = RECORD["claims"][claim.key]
        assert claim.judge(results) == (kept["measured"], kept["verdict"]), claim.key


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.skipif(git("rev-parse", "--is-shallow-repository").stdout != "false\n", reason="no history of commits")
def test_a_claim_names_a_commit_that_a_clone_has():
    for commit in {claim["commit"] for claim in RECORD["claims"].values()}:
        assert commit is not None
        assert git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0, commit


def test_facts_and_tables_are_those_of_the_files(tmp_path):
    """What needs no flight is computed again; what does was kept, and names the command that makes it."""
    fresh = {claim.key: claim for claim in claims.all_claims(Results(tmp_path))}
    for key, kept in RECORD["claims"].items():
        if fresh[key].command:
            fixed = ("key", "where", "claim", "command", "figure")
            assert {name: kept[name] for name in fixed} == {name: getattr(fresh[key], name) for name in fixed}
        else:
            assert kept == dataclasses.asdict(fresh[key]) | {"commit": kept["commit"]}
    assert RECORD["tables"] == {name: rows() for name, rows in facts.TABLES.items()}
