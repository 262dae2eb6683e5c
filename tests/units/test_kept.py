"""Kept results: rows of flights pooled over any axis, the page that shows them, and numbers in prose tied to them."""

import numpy as np
import pandas as pd
import pytest

from docs import ties
from experiments.report import keep, kept
from experiments.report.findings import Finding
from experiments.report.kept import Axis, Kept
from experiments.report.verdicts import AGREES

AXES = [Axis("controller", "controller", "", ["a", "b"]), Axis("speed", "wind speed", "m/s", [0.0, 10.0])]


def flown(**columns):
    """Eight flights: two of each controller at each speed; that of `b` at 10 m/s are lost."""
    lost = np.repeat([False, False, False, True], 2)
    made_up = {
        "controller": np.repeat(["a", "b"], 4),
        "speed": np.tile(np.repeat([0.0, 10.0], 2), 2),
        "outcome": np.where(lost, "fell", "completed"),
        "max_rotation_error": np.radians([1.0, 2.0, 3.0, 4.0, 5.0, 20.0, 95.0, 95.0]),
        "max_com_error": np.full(8, 0.02),
        "degraded_time": np.where(lost, 3.0, 0.0),
        "nominal_until": np.where(lost, 18.5, 50.0),
        "onset": np.full(8, 18.0),
        "warning_time": np.where(lost, [0.2] * 7 + [0.4], np.nan),
        "lost_time": np.where(lost, 20.0, np.nan),
        "all_modes": np.where(lost, 1024 + 2, 2),
    }
    return pd.DataFrame(made_up | columns)


def rows(flights, axes=AXES, pair=None):
    return {tuple(levels): figures for levels, figures in keep._rows(flights, axes, pair)}


def test_flights_are_pooled_over_every_axis():
    found = rows(flown())
    assert set(found) == {(a, s) for a in ("a", "b", "all") for s in (0.0, 10.0, "all")}
    assert [found[key]["flights"] for key in (("a", 0.0), ("a", "all"), ("all", 10.0), ("all", "all"))] == [2, 4, 4, 8]
    assert (
        found["b", "all"] | {"completed": 2, "lost": 2, "unwarned": 1, "degraded": 2, "on_course": 1}
        == found["b", "all"]
    )


def test_errors_are_those_of_flights_that_complete():
    found = rows(flown())
    assert found["all", "all"]["rotation_deg_worst"] == pytest.approx(20.0)
    assert found["a", "all"]["rotation_deg_median"] == pytest.approx(2.5)
    assert found["b", 10.0]["rotation_deg_median"] is None
    assert found["a", 0.0]["com_cm_worst"] == pytest.approx(2.0)


def test_a_failure_is_found_after_its_onset_and_a_loss_announced_before_it():
    found = rows(flown())
    assert found["b", 10.0]["found_s"] == pytest.approx(0.5)
    assert found["b", 10.0]["announced_s"] == pytest.approx(0.3)
    assert found["a", 0.0]["found_s"] is None
    assert (found["b", 10.0]["modes"], found["all", "all"]["modes"]) == (1026, 2)


def test_a_level_of_pairs_has_the_flights_in_which_it_is_either():
    flights = flown().iloc[:3].assign(fault=["x", "x", "y"], fault_2=["y", "z", "z"])
    found = rows(flights, [Axis("fault", "fault", "", ["x", "y", "z"])], ("fault", "fault_2"))
    assert {key: figures["flights"] for key, figures in found.items()} == {("x",): 2, ("y",): 2, ("z",): 2, ("all",): 3}


@pytest.mark.parametrize(
    ("disturbances", "onset"),
    [
        ({}, 0.0),
        ({"outages": [{"start": 18.0}, {"start": 5.0}]}, 5.0),
        ({"jets": {"failure": {"time": 28.0}}}, 28.0),
        ({"jets": {"lag": 0.1}, "joints": [{"start": 7.0}]}, 7.0),
    ],
)
def test_failures_begin_with_the_first(disturbances, onset):
    assert keep._onset({"disturbances": disturbances}) == onset


def made_up(**more):
    table = [[*levels, *keep._shorten(list(figures.values()))] for levels, figures in rows(flown()).items()]
    parts = {
        "name": "made_up", "result": "sweeps/made_up", "title": "Made up", "command": "jax-aero sweep made_up",
        "created": "2026-01-02T03:04:05+00:00", "commit": "0123456789abcdef", "digest": "d", "code": "c", "seed": 1,
        "each": "2 in each cell, perturbed", "axes": AXES, "panels": "controller", "shows": ["errors"],
        "outcomes": {"completed": 6, "fell": 2}, "columns": ["controller", "speed", *keep.FIGURES], "rows": table,
        "about": "A push of 50 N.",
    }  # fmt: skip
    return Kept(**(parts | more))


def test_the_page_has_a_table_with_the_panels_side_by_side():
    text = kept.page(made_up()).markdown()
    assert "| wind speed | a | b |" in text
    assert "| 0 m/s | 2 of 2, 1.5° (2.0), 2.0 cm (2.0) | 2 of 2, 12.5° (20.0), 2.0 cm (2.0) |" in text
    assert "| 10 m/s | 2 of 2, 3.5° (4.0), 2.0 cm (2.0) | 0 of 2 |" in text
    assert "8 flights (2 in each cell, perturbed): 6 completed, 2 fell." in text
    assert "2026-01-02, commit 0123456789, seed 1" in text


def test_levels_that_repeat_the_row_before_are_left_out():
    table = kept.table(made_up(panels="", axes=[AXES[0], AXES[1]]))
    assert table.headings == ["wind speed", "a", "b"]
    third = Axis("c", "c", "", ["p", "q"])
    assert [list(kept._labels([AXES[1], third], levels, before)) for before, levels in (
        ({}, {"speed": 0.0, "c": "p"}), ({"speed": 0.0, "c": "p"}, {"speed": 0.0, "c": "q"}),
    )] == [["0 m/s", "p"], ["", "q"]]  # fmt: skip


def test_what_is_kept_is_read_again(tmp_path, monkeypatch):
    document = made_up(claims={"k": Finding("all of 8", AGREES)}, states={"k": "It flies."})
    (tmp_path / "made_up.json").write_text(kept.to_json(document), encoding="utf-8")
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    kept.read.cache_clear()
    assert kept.read("made_up") == document
    assert kept.findings() == document.claims
    kept.read.cache_clear()


def test_cases_with_the_same_figures_are_a_table():
    summary = {"a": {"rms": 0.5, "n": 3}, "b": {"rms": 0.25}, "c, d: rms": 0.125, "mass [kg]": 4.61}
    text = kept.page(made_up(rows=[], summary=summary)).markdown()
    assert "| case | rms | n |\n| --- | --- | --- |\n| a | 0.5 | 3 |" in text
    assert "| case | rms |\n| --- | --- |\n| b | 0.25 |\n| c, d | 0.125 |" in text
    assert "| mass [kg] | 4.61 |" in text


# --- ties


@pytest.fixture
def tied(monkeypatch, tmp_path):
    """What is wrong with a text that is tied to a made-up result."""
    (tmp_path / "made_up.json").write_text(kept.to_json(made_up(summary={"drag [m2]": 0.2401, "share": 0.31})))
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    kept.read.cache_clear()
    ties.source.cache_clear()
    yield lambda text: [found.partition(": ")[2] for found in ties.loose(f"{text}\n<!-- from: made_up -->\n")]
    kept.read.cache_clear()
    ties.source.cache_clear()


@pytest.mark.parametrize(
    "text",
    [
        "It leans by 1.5° and at most 4°, off by 2 cm or 20 mm.",
        "4 of 4 complete, with 2 to 3.5° at 10 m/s after a push of 50 N.",
        "None of 2 complete, all of the 4 do; 2 of 4 are lost.",
        "Found after 0.5 s (500 ms).",
        "The drag is 0.24 m², the share 31 %.",
        "`5.5 s` and $6.6 s$ are no numbers of a page, nor is [a link](x_7.7s.md) or TEST2.",
    ],
)
def test_numbers_of_a_result_are_accepted_at_any_rounding(tied, text):
    assert tied(text) == []


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("It leans by 1.6°.", "1.6 °"),
        ("It is off by 2.1 cm.", "2.1 cm"),
        ("5 of 6 complete.", "5 of 6"),
        ("With 1.5, 7.5 and 2°.", "7.5 °"),
        ("The drag is 0.2402 m².", "0.2402 m²"),
        ("The drag is 0.25 m².", "0.25 m²"),
        ("It takes 1.5 s.", "1.5 s"),
    ],
)
def test_another_number_is_named(tied, text, wrong):
    assert tied(text) == [f"{wrong} is not in made_up"]


def test_a_number_without_a_source_is_named_with_its_line():
    page = "# Page of 3 s\n\nNo number.\n\nIt takes 1.5 s\nor longer.\n\n<!-- a comment of 9 s -->\n"
    assert list(ties.loose(page)) == ["line 5: 1.5 s is not tied to a result"]
    assert list(ties.loose(page.replace("longer.", "longer. <!-- from: paper -->"))) == []


def test_a_file_of_the_repository_is_a_source():
    assert list(ties.loose("A side wind of 10 m/s. <!-- from: configs/wind/lateral_ramp.toml -->")) == []
    assert len(list(ties.loose("A side wind of 11.5 m/s. <!-- from: configs/wind/lateral_ramp.toml -->"))) == 1
    with pytest.raises(ValueError, match="no kept result and no file"):
        list(ties.loose("It takes 1 s. <!-- from: nothing -->"))
