"""`make reproduce`: what fails is named and costs nothing else, and a verdict that is not the kept one fails."""

import json
import shutil

import msgspec
import pytest

from experiments.report import paper, reproduce
from experiments.report.command import check, documented
from experiments.report.judge import AGREES, NOT_FLOWN, Kind, Verdict
from experiments.report.results import Results
from jax_aero.base import places


@pytest.fixture
def ran(monkeypatch, tmp_path):
    """The commands that were run; those of the list that fail."""
    found, failing = [], {}
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    monkeypatch.setattr(reproduce, "run", lambda line: found.append(line) or failing.get(line, ""))
    return found, failing


def test_one_failure_costs_neither_the_other_commands_nor_the_report(ran, tmp_path):
    found, failing = ran
    assert reproduce.main([]) == 0
    every = list(found)
    assert every[-1] == "jax-aero report --check"
    found.clear()
    failing["jax-aero study along"] = "error: no power"
    assert reproduce.main([]) == 1
    assert found == every
    results = Results(tmp_path)
    clearance = paper.all_claims()["clearance"].find(results)
    assert (clearance.measured, clearance.verdict) == ("`jax-aero study along` failed: error: no power", NOT_FLOWN)


def test_the_reason_of_a_failure_is_what_the_command_says_last(capfd):
    assert reproduce.run("jax-aero fly no_such_flight").startswith("error: ")
    assert "no_such_flight" in capfd.readouterr().err
    assert reproduce.run("jax-aero fly --list") == ""


def test_what_is_not_wanted_is_left_out(ran, monkeypatch):
    monkeypatch.setattr(paper.shutil, "which", lambda _: "simpleFoam")
    reproduce.main(["--skip", "cfd", "convergence"])
    assert not [line for line in ran[0] if line.startswith(("jax-aero cfd", "jax-aero sweep convergence"))]
    assert "jax-aero study along" in ran[0]


def test_what_is_of_other_numerics_is_made_again(made_up_results, monkeypatch, tmp_path):
    shutil.copytree(made_up_results / "flight", tmp_path / "flight")
    path = tmp_path / "flight" / "test2" / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"numerics": {"crate": 0}}))
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert reproduce.renewal("jax-aero fly test2") == " --overwrite"
    assert [reproduce.renewal(f"jax-aero {line}") for line in ("fly test1", "fly no_wind", "study trim hover")] == [
        ""
    ] * 3


def test_a_verdict_that_is_not_the_kept_one_fails(capsys):
    kept = documented()
    key, finding = next((key, one) for key, one in kept.items() if paper.all_claims()[key].commands)
    assert check(kept) == 0
    assert check(kept | {key: msgspec.structs.replace(finding, verdict=NOT_FLOWN)}) == 0
    for wrong in (AGREES, Verdict(Kind.DIFFERS, "differs")):
        if wrong != finding.verdict:
            assert check(kept | {key: msgspec.structs.replace(finding, verdict=wrong)}) == 1
            assert f"{key}: {wrong}; the documentation has: {finding.verdict}" in capsys.readouterr().err


def test_a_command_of_several_flights_is_one_of_each():
    assert paper.each(["fly test1 test2", "study along"]) == [
        "jax-aero fly test1",
        "jax-aero fly test2",
        "jax-aero study along",
    ]
