"""What a result is of, and unfinished work: another configuration, file or version of numbers is not taken for it."""

import pytest

from jax_aero.base import kinds, places
from jax_aero.results import identity
from jax_aero.results.identity import CRATE, PYTHON, Identity
from jax_aero.results.work import Work


@pytest.fixture
def named(tmp_path):
    path = tmp_path / "named.toml"
    path.write_text("x = 1")
    return path


def test_configuration_files_and_numerics_count(named, monkeypatch):
    made = Identity.of({"a": 1}, [named])
    kept = made.facts | {"git": {"commit": "c" * 40}}
    assert Identity.of({"a": 1}, [named]).difference(kept) == ""
    assert Identity.of({"a": 2}, [named]).difference(kept) == "another configuration"
    named.write_text("# A comment, and another layout.\nx   =   1\n")
    assert Identity.of({"a": 1}, [named]).difference(kept) == ""
    named.write_text("x = 2")
    assert Identity.of({"a": 1}, [named]).difference(kept) == "another configuration"
    monkeypatch.setitem(identity.VERSIONS, PYTHON, 9)
    assert made.difference(kept) == "other numerics (jax_aero 1 instead of 9, commit cccccccccc)"
    assert identity.other_numerics({"numerics": {CRATE: 1}}) == "", "flights of the crate are not of Python"


def test_a_result_from_before_there_were_versions_has_the_first(monkeypatch):
    older = {"backend": "rust", "code_hash": "0"}
    assert identity.other_numerics(older) == ""
    monkeypatch.setitem(identity.VERSIONS, PYTHON, 2)
    assert identity.other_numerics(older) == ""
    assert identity.other_numerics({"backend": "jax"}) == "other numerics (jax_aero 1 instead of 2)"
    monkeypatch.setitem(identity.VERSIONS, CRATE, 2)
    assert identity.other_numerics(older) == "other numerics (crate 1 instead of 2)"


DAMAGES = {
    "empty": lambda *_: b"",
    "cut short": lambda whole, _: whole[:-1],
    "a bit turned": lambda whole, _: whole[:40] + bytes([whole[40] ^ 1]) + whole[41:],
    "of another job": lambda _, other: other,
    "foreign": lambda *_: b"PAR1 of another program",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_answer_of_a_job_does_not_count(tmp_path, damage, capsys):
    work = Work.on(tmp_path / "result", Identity("0"))
    for job in ("a", "b"):
        work.write_json(job, {"answer": [job, 1.5, None]})
    assert [work.read_json(job)["answer"][0] for job in ("a", "b")] == ["a", "b"]
    whole, other = (work.path(job).read_bytes() for job in ("a", "b"))
    work.path("a").write_bytes(DAMAGES[damage](whole, other))
    assert work.read("a") is None
    assert capsys.readouterr().err == "a.part is damaged, and made again\n"
    assert work.read("b") is not None


def test_work_of_another_identity_does_not_count_and_is_left_until_there_is_a_result(tmp_path):
    own, other = (Work.on(tmp_path / "result", Identity(digest)) for digest in "01")
    own.write("job", b"own")
    assert other.read("job") is None
    assert own.narrowed(Identity("2")).read("job") is None
    other.write("job", b"other")
    assert own.read("job") == b"own"
    other.clear()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "kind", "names"),
    [
        ("jax-aero fly test2 --overwrite", "flight", ["test2", "--overwrite"]),
        ("jax-aero sweep paper_tests", "sweeps", ["paper_tests"]),
        ("jax-aero study identify-engine engine", "identify_engine", ["engine"]),
        ("jax-aero cfd open", "cfd", ["open"]),
        ("jax-aero cfd flow flight30", "cfd_flow", ["flight30"]),
        ("jax-aero data fit-aero open", "fit_aero", ["open"]),
        ("jax-aero train open --dataset x.nc", "training", ["open", "--dataset", "x.nc"]),
        ("jax-aero train search compact", "training_search", ["compact"]),
        ("jax-aero train flights --base hover a.nc", "training_flights", ["hover", "a.nc"]),
    ],
)
def test_a_command_makes_results_of_one_kind(line, kind, names):
    found, words = kinds.of_line(line)
    assert (found.name, words) == (kind, names)
    assert kinds.find(kind) == found
    assert found.line("x--a=1").startswith(f"jax-aero {found.command} x ")
    assert found.name in kinds.KINDS or (places.STUDIES / found.name).is_dir()
