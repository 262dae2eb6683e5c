"""Kept results: rows of flights, pooled when they are read, and the page that shows them."""

import hashlib
import json

import msgspec
import numpy as np
import pandas as pd
import pytest

from experiments.report import paper, stored
from experiments.report.judge import Kind
from jax_aero import backends
from jax_aero.base.result import UPRIGHT
from jax_aero.base.terminal import Refused
from jax_aero.results import manifest
from jax_aero.stored import keep, kept
from jax_aero.stored.kept import Axis, Kept
from jax_aero.sweep import aggregate, spec
from jax_aero.sweep.columns import FLIGHT
from jax_aero.sweep.design import Design
from jax_aero.sweep.intervals import wilson

AXES = [Axis("controller", "controller", "", ["a", "b"]), Axis("speed", "wind speed", "m/s", [0.0, 10.0])]


def flown(**columns):
    """Eight flights: two of each controller at each speed; that of `b` at 10 m/s are lost."""
    lost = np.repeat([False, False, False, True], 2)
    made_up = {
        "controller": np.repeat(["a", "b"], 4),
        "speed": np.tile(np.repeat([0.0, 10.0], 2), 2),
        "outcome": np.where(lost, "fell", "completed"),
        "max_rotation_error_deg": np.array([1.0, 2.0, 3.0, 4.0, 5.0, 20.0, 95.0, 95.0]),
        "max_com_error": np.full(8, 0.02),
        "degraded_time": np.where(lost, 3.0, 0.0),
        "nominal_until": np.where(lost, 18.5, 50.0),
        "onset": np.full(8, 18.0),
        "warning_time": np.where(lost, [0.2] * 7 + [0.4], np.nan),
        "lost_time": np.where(lost, 20.0, np.nan),
        "all_modes": np.where(lost, 1024 + 2, 2),
    }
    return pd.DataFrame(dict.fromkeys(FLIGHT, np.zeros(8)) | made_up | columns)


def rows(flights, axes=AXES, pair=None):
    return {tuple(levels): figures for levels, figures in keep._rows(flights, axes, pair)}


def pooled(over, document=None):
    """Figures by level of the axes that are not pooled."""
    document = document or made_up()
    names = [axis.name for axis in document.axes if axis.name not in over]
    return {tuple(row[name] for name in names): row for row in document.table(frozenset(over))}


def test_flights_are_pooled_over_any_axis_when_they_are_read():
    assert set(rows(flown())) == {(a, s) for a in ("a", "b") for s in (0.0, 10.0)}
    of_controller, of_speed, whole = pooled({"speed"}), pooled({"controller"}), pooled({"speed", "controller"})
    counted = (of_controller["a",], of_speed[10.0,], whole[()])
    assert [row["flights"] for row in counted] == [4, 4, 8]
    expected = {"completed": 2, "lost": 2, "unwarned": 1, "degraded": 2, "on_course": 1, "speed": "all"}
    assert of_controller["b",] | expected == of_controller["b",]
    assert (whole[()]["rotation_error_deg_worst_of_upright"], whole[()]["rotation_error_deg_median_of_upright"]) == (
        pytest.approx(20.0),
        None,
    )
    assert whole[()]["rotation_error_deg_worst_of_all"] == np.inf


def test_the_high_error_is_that_of_nine_tenths():
    """Of eleven flights with 0 to 10 degrees and 0 to 10 cm: 9, not the 8 or 10 of another share."""
    ramp = np.arange(11.0)
    flights = pd.concat([flown().iloc[:1]] * 11).assign(max_rotation_error_deg=ramp, max_com_error=0.01 * ramp)
    found = keep.figures(flights)
    ends = {"median": 5.0, "p90": 9.0, "worst": 10.0}
    factors = {"rotation_error_deg": 1.0, "com_error": 0.01}
    expected = {f"{name}_{end}_of_all": f * value for name, f in factors.items() for end, value in ends.items()}
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_errors_of_upright_flights_are_beside_those_of_all():
    found = rows(flown())
    assert found["b", 0.0]["rotation_error_deg_worst_of_upright"] == pytest.approx(20.0)
    assert found["a", 10.0]["rotation_error_deg_median_of_upright"] == pytest.approx(3.5)
    assert found["b", 10.0]["rotation_error_deg_median_of_upright"] is None
    assert found["b", 10.0]["rotation_error_deg_median_of_all"] == np.inf
    assert found["a", 0.0]["com_error_worst_of_upright"] == pytest.approx(0.02)


def test_a_failure_is_found_after_its_onset_and_a_loss_announced_before_it():
    found = rows(flown())
    assert found["b", 10.0]["found_s"] == pytest.approx(0.5)
    assert found["b", 10.0]["announced_s"] == pytest.approx(0.3)
    assert found["a", 0.0]["found_s"] is None
    assert (found["b", 10.0]["modes"], found["a", 0.0]["modes"]) == (1026, 2)


def test_a_level_of_pairs_has_the_flights_in_which_it_is_either():
    flights = flown().iloc[:3].assign(fault=["x", "x", "y"], fault_2=["y", "z", "z"])
    axes = [Axis("fault", "fault", "", ["x", "y", "z"])]
    found = rows(flights, axes, ("fault", "fault_2"))
    assert {key: figures["flights"] for key, figures in found.items()} == {("x",): 2, ("y",): 2, ("z",): 2}
    table = [[*levels, *figures.values()] for levels, figures in found.items()]
    document = made_up(axes=axes, columns=["fault", *aggregate.KEPT], rows=table, paired="fault")
    assert pooled({"fault"}, document)[()]["flights"] == 3


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
        "created": "2026-01-02T03:04:05+00:00", "commit": "0123456789abcdef", "digest": "d", "seed": 1,
        "each": "2 in each cell, perturbed", "axes": AXES, "panels": "controller", "shows": ["errors"],
        "outcomes": {"completed": 6, "fell": 2}, "columns": ["controller", "speed", *aggregate.KEPT], "rows": table,
        "about": "A push of 50 N.",
    }  # fmt: skip
    return Kept(**(parts | more))


def test_the_page_has_one_quantity_a_column_and_the_panels_below_each_other():
    text = stored.page(made_up())
    rotation, position = (
        f"{name} error, median of all [{unit}] | {name} error, median of upright [{unit}] | "
        f"{name} error, greatest of upright [{unit}]"
        for name, unit in (("rotation", "°"), ("position", "cm"))
    )
    assert f"| wind speed | controller | completed | fell | {rotation} | {position} |" in text
    rows = [
        "| 0 m/s | a | 2 of 2 | 0 of 2 | 1.50 | 1.50 | 2.00 | 2.00 | 2.00 | 2.00 |",
        "| 0 m/s | b | 2 of 2 | 0 of 2 | 12.5 | 12.5 | 20.0 | 2.00 | 2.00 | 2.00 |",
        "| 10 m/s | a | 2 of 2 | 0 of 2 | 3.50 | 3.50 | 4.00 | 2.00 | 2.00 | 2.00 |",
        "| 10 m/s | b | 0 of 2 | 2 of 2 | lost | | | lost | | |",
    ]
    assert "\n".join(rows) in text
    assert "8 flights (2 in each cell, perturbed): 6 completed, 2 fell." in text
    assert "2026-01-02, commit 0123456789, seed 1" in text


def test_a_row_counts_every_outcome():
    ends = ["completed", "landed", "landing", "off_course", "crashed", "crashed", "fell", "diverged"]
    row = dict(zip(aggregate.KEPT, keep.figures(flown(outcome=ends)).values(), strict=True))
    assert (row["lost"], row["rotation_error_deg_worst_of_upright"]) == (6, pytest.approx(2.0))
    document = made_up(axes=[], columns=list(row), rows=[list(row.values())], shows=[])
    (shown,) = kept.page_table(document)[1]
    assert shown == [f"{count} of 8" for count in (1, 1, 1, 1, 2, 2)]


def test_what_is_kept_is_read_again(tmp_path, monkeypatch):
    document = made_up()
    (tmp_path / "made_up.json").write_text(keep.to_json(document), encoding="utf-8")
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    kept.read.cache_clear()
    assert kept.read("made_up") == msgspec.structs.replace(document, seal=kept.seal_of(document))
    assert stored.findings() == {}
    kept.read.cache_clear()


@pytest.mark.parametrize("name", kept.names())
def test_a_kept_result_with_another_number_is_refused(name, tmp_path, monkeypatch):
    """A count of one row, or else a figure of the summary; and no row is a sum of others."""
    document = kept.read(name)
    assert not [row for row in document.rows if kept.ALL in row[: len(document.axes)]]
    table, place = msgspec.to_builtins(document), document.columns.index("unwarned") if document.rows else 0
    if document.rows:
        table["rows"][-1][place] += 1
    else:
        table["summary"] = {**table["summary"], next(iter(table["summary"])): 0.125}
    (tmp_path / f"{name}.json").write_text(json.dumps(table), encoding="utf-8")
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    kept.read.cache_clear()
    with pytest.raises(Refused, match=rf"{name}\.json is not what was written there"):
        kept.read(name)
    kept.read.cache_clear()


SEALED = [name for name in kept.names() if kept.read(name).rows]


@pytest.mark.parametrize("name", SEALED)
def test_a_sealed_row_that_contradicts_itself_is_refused(name, tmp_path, monkeypatch):
    """One count or error that another does not follow, sealed as if it had been written so."""
    document = kept.read(name)
    row = len(document.rows) // 2
    flips = [(column, lambda value: value + 1) for column in ("flights", "completed", "landed", "landing", "lost")]
    errors = ("rotation_error_deg_worst_of_upright", "com_error_worst_of_all", "rotation_error_deg_p90_of_all")
    flips += [(column, lambda _: 1e-9) for column in errors]
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    assert kept.contradiction(document) == ""
    for column, change in flips:
        rows, place = [[*one] for one in document.rows], document.columns.index(column)
        if rows[row][place] is None:
            continue
        rows[row][place] = change(rows[row][place])
        (tmp_path / f"{name}.json").write_text(keep.to_json(msgspec.structs.replace(document, rows=rows)), "utf-8")
        kept.read.cache_clear()
        with pytest.raises(Refused, match="contradicts itself"):
            kept.read(name)
    kept.read.cache_clear()


def test_a_kept_verdict_is_that_of_its_rows_by_the_present_claims_of_the_present_sweep(monkeypatch):
    """The judge, a bound or a configuration that changes changes it: nothing of it is kept."""
    today = Design(spec.load("robot_mission_loss")).digest
    document = msgspec.structs.replace(kept.read("robot_mission_loss"), digest=today)
    assert {one.verdict.kind for one in stored.claims(document).values()} <= {Kind.AGREES, Kind.DIFFERS, Kind.IN_PART}
    place = {name: document.columns.index(name) for name in ("completed", "landed", "lost", "flights")}
    rows = [[*row] for row in document.rows]
    for row in rows:
        row[place["completed"]] = row[place["landed"]] = 0
        row[place["lost"]] = row[place["flights"]]
    fallen = msgspec.structs.replace(document, rows=rows)
    assert {one.verdict.kind for one in stored.claims(fallen).values()} == {Kind.DIFFERS}
    other = msgspec.structs.replace(document, digest="of c0 = 5")
    assert {one.verdict.kind for one in stored.claims(other).values()} == {Kind.OUTDATED}
    replace = msgspec.structs.replace
    claims = stored.stated(document).values()
    strict = [replace(one, share=tuple(replace(share, at_most=0.0) for share in one.share)) for one in claims]
    monkeypatch.setattr(paper, "stated", lambda _: tuple(strict))
    assert stored.claims(document)["mission_loss_paper"].verdict.kind is Kind.DIFFERS


def test_cases_with_the_same_figures_are_a_table():
    summary = {"a": {"rms": 0.5, "n": 3}, "b": {"rms": 0.25}, "c, d: rms": 0.125, "mass [kg]": 4.61}
    text = stored.page(made_up(rows=[], summary=summary))
    assert "| | rms | n |\n|---|---|---|\n| a | 0.5000 | 3 |" in text
    assert "| | rms |\n|---|---|\n| b | 0.2500 |\n| c, d | 0.1250 |" in text
    assert "| mass | 4.610 kg |" in text
    # Where a page chooses the cases, one that lacks a figure has an empty cell.
    _, cells = kept.study_table(made_up(rows=[], summary=summary), ["rms", "n"], ["a", "b"])
    assert cells == [["a", "0.50", "3"], ["b", "0.25", ""]]


# --- flown again

SWEPT = [name for name in kept.names() if any(kept.read(name).firsts)]
ELSEWHERE = [name for name in kept.names() if kept.read(name).firsts and not any(kept.read(name).firsts)]
FLOWN = 3
"""Flights of a cell whose share is compared."""
TO_FLY: set[str] = set()
"""Stored sweeps of an earlier configuration, or whose flights have other bits by now, to be flown anew."""


def pick(name, cells):
    """The cell that the commit chooses."""
    commit = (manifest.git_state() or {}).get("commit")
    return cells[int(hashlib.sha256(f"{commit} {name}".encode()).hexdigest(), 16) % len(cells)]


@pytest.mark.parametrize("name", kept.names())
def test_what_is_to_be_flown_anew_is_listed(name):
    document = kept.read(name)
    if document.result.startswith("sweeps/"):
        today = Design(spec.load(document.result.removeprefix("sweeps/"))).digest
        assert document.digest == today or name in TO_FLY


@pytest.mark.parametrize("name", [name for name in SWEPT if name not in TO_FLY])
def test_a_kept_sweep_flies_as_it_did(name):
    """The first flight of one cell, which the commit chooses. One that does not is flown anew, or withdrawn."""
    document = kept.read(name)
    cell = pick(name, [cell for cell, first in enumerate(document.firsts) if first])
    assert keep.fly_again(document, cell) == document.firsts[cell], f"cell {cell}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_kept_sweep_whose_bits_are_those_of_its_processor_succeeds_as_often(name):
    """By the intervals of its share and of that of some flights here, in a cell that the commit chooses."""
    design = Design(spec.load(name))
    cell = pick(name, range(len(design.cells)))
    configs = [design.row_config(repeat * len(design.cells) + cell) for repeat in range(FLOWN)]
    flown = backends.backend(design.spec.backend).fly_batch(configs)
    here = wilson(sum(flight.outcome in UPRIGHT for flight in flown), FLOWN)
    there = kept.read(name).sweep.rows[cell]
    assert max(here[0], there["upright_low"]) <= min(here[1], there["upright_high"]), cell


def test_a_kept_sweep_of_other_cells_is_not_flown_again():
    document = made_up(result="sweeps/mk3_mass", firsts=[["completed", 1.0, 2.0, 3.0, 4.0]])
    with pytest.raises(Refused, match="made_up keeps 1 cells; its sweep has 3"):
        keep.fly_again(document, 0)


def test_a_picture_has_the_figures_of_the_table():
    sweep = made_up(drawing="curve").sweep
    cell = sweep.cells.set_index(["controller", "speed"]).loc["a", 10.0]
    assert cell["rotation_error_deg_median_of_all"] == pytest.approx(3.5)
    assert cell["com_error_worst_of_upright"] == pytest.approx(0.02)
    assert (cell["flights"], cell["completed"], len(sweep.cells)) == (2, 2, 4)
