"""What a result is of: another configuration, file or code is not taken for it."""

import pytest

from experiments.identity import Identity
from experiments.progress import Progress

MODULES = ("experiments.flight",)


@pytest.fixture
def named(tmp_path):
    path = tmp_path / "named.toml"
    path.write_text("x = 1")
    return path


def test_configuration_files_and_code_count(named, monkeypatch):
    identity = Identity.of({"a": 1}, MODULES, [named])
    kept = identity.facts | {"git": {"commit": "c" * 40}}
    assert Identity.of({"a": 1}, MODULES, [named]).difference(kept) == ""
    assert Identity.of({"a": 2}, MODULES, [named]).difference(kept) == "another configuration"
    named.write_text("x = 2")
    assert Identity.of({"a": 1}, MODULES, [named]).difference(kept) == "another configuration"
    assert Identity(identity.digest, ("experiments.air",)).difference(kept) == "other code (commit cccccccccc)"
    monkeypatch.setattr("experiments.identity.code_hash", lambda *_: "other")
    assert identity.difference(kept).startswith("other code")


def test_finished_jobs_of_another_identity_are_made_again(tmp_path):
    path, own = tmp_path / "folder" / "jobs", Identity("0", MODULES)
    first = Progress(path, own)
    first.add("a", [1.5, None])
    first.add("b", "two")
    with path.open("a") as file:
        file.write('\n["cut sho')
    assert Progress(path, own).done == {"a": [1.5, None], "b": "two"}
    for other in (Identity("1", MODULES), Identity("0", ("experiments.air",))):
        assert Progress(path, other).done == {}
