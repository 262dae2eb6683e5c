"""Committed files that follow from others are up to date."""

import subprocess
from pathlib import Path

import pytest

from docs import gallery
from experiments.report import command, judge
from experiments.tools import generated
from jax_aero import rust
from jax_aero.base import places
from jax_aero.figures.catalogue import FIGURES
from jax_aero.stored import kept

ROOT = Path(__file__).resolve().parents[2]


def test_everything_generated_is_up_to_date():
    made = generated.files()
    stale = [str(path.relative_to(ROOT)) for path in generated.outdated(made)]
    assert not stale, "outdated: run `make generated`"
    committed = {*(places.CONFIGS / "schema").iterdir(), *(ROOT / "experiments/studies").glob("*/schema.json")}
    assert committed <= set(made), "made from nothing that is there"


FLOWN = {name for name in gallery.pictures() if FIGURES[name].kind in ("flight", "")}


def test_the_gallery_shows_flights_and_tables():
    assert {path.stem for path in (ROOT / "docs/img/gallery").glob("*.png")} <= FLOWN


@pytest.mark.parametrize("name", sorted({*FLOWN, *gallery.FILMS}))
def test_pictures_of_flights_are_of_these_flights(name):
    film = gallery.FILMS.get(name)
    runs = film.shown if film else FIGURES[name].runs
    shown = gallery.made_of(gallery.Film.path(name) if film else gallery.pictures()[name])
    if not runs:
        assert shown == gallery.tables(FIGURES[name])
    flown_here = [run for run in runs if rust.load_config(run)["backend"] == "rust"]  # the same bits everywhere
    assert set(shown) >= set(runs)
    for run in flown_here:
        flown = rust.fly(rust.load_config(run))
        assert shown[run] == gallery.of_flight({"outcome": flown.outcome, "summary": flown.summary}), run


def share(name: str, of: str, **levels: str) -> str:
    """Return a share of a stored sweep, over its cells at these levels, as a sentence has it."""
    document = kept.read(name)
    cells = [dict(zip(document.columns, row, strict=True)) for row in document.rows]
    chosen = [cell for cell in cells if levels.items() <= cell.items()]
    return f"{sum(cell[of] for cell in chosen)} of {sum(cell['flights'] for cell in chosen)}"


def test_captions_of_the_films_state_stored_shares():
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    gale = {"world": "corrected arms, 18 m/s from ahead"}
    baseline = share("ablation_terms", "completed", feedback="nothing (baseline)", **gale)
    aware = share("ablation_terms", "completed", feedback="everything", **gale)
    assert f"it completes {baseline} such flights, the aware controller {aware}." in text
    landed = share("robot_mission_loss", "landed", mission="the paper's, 19 s")
    assert f"at five times of this flight {landed} perturbed robots do" in text


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.skipif(
    git("rev-parse", "--is-shallow-repository").stdout != "false\n",
    reason="no history of commits: git fetch --unshallow",
)
def test_kept_results_and_claims_name_a_commit_that_a_clone_has():
    commits = {name: kept.read(name).commit for name in kept.names()}
    commits |= {claim: finding.commit for claim, finding in judge.read(command.CLAIMS).items()}
    for name, commit in commits.items():
        assert commit is not None, name
        assert git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0, name
