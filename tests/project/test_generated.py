"""Committed files that follow from others are up to date, and numbers in pages of results are those of the results."""

from pathlib import Path

import pytest

from docs import ties
from experiments import generated
from experiments.report import kept
from jax_aero import places

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
