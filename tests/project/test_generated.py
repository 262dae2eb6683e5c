"""Committed files that follow from others are up to date, and numbers in pages of results are those of the results."""

import subprocess
from pathlib import Path

import pytest

from docs import ties
from experiments import generated
from experiments.report import kept
from jax_aero.base import places

ROOT = Path(__file__).resolve().parents[2]


def test_everything_generated_is_up_to_date():
    made = generated.files()
    stale = [str(path.relative_to(ROOT)) for path in generated.outdated(made)]
    assert not stale, "outdated: run `make generated`"
    folders = (places.CONFIGS / "schema", kept.FOLDER)
    committed = {path for folder in folders for path in folder.iterdir() if path.suffix in (".md", ".json")}
    sources = {kept.FOLDER / f"{name}.json" for name in kept.names()}
    assert committed - sources <= set(made), "made from nothing that is there"


@pytest.mark.parametrize("page", ties.PAGES)
def test_numbers_of_a_page_of_results_are_tied_to_them(page):
    assert list(ties.loose((ROOT / "docs" / page).read_text(encoding="utf-8"))) == []


def test_a_picture_is_that_of_a_kept_result():
    assert {path.stem for path in kept.FOLDER.glob("*.webp")} <= set(kept.names())


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)


WITHOUT_COMMIT = {"cfd_mk3_fit", "cfd_mk3_meshes", "cfd_mk3_primitives", "cfd_mk3_tunnel"}
"""Results of commits that the history lacks: days of flow cases, of which the digest of the code is known."""


@pytest.mark.skipif(git("rev-parse", "--is-shallow-repository").stdout != "false\n", reason="no history of commits")
def test_a_kept_result_names_a_commit_that_a_clone_has():
    for name in kept.names():
        commit = kept.read(name).commit
        if name in WITHOUT_COMMIT:
            assert commit is None
            continue
        assert commit is not None
        assert git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0, name
