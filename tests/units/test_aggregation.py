"""The figures of a cell are the same from the flights of a folder and from what is kept of them; losses count."""

import msgspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from experiments.report import judge, stored
from experiments.report.judge import Kind
from experiments.report.measures import results
from jax_aero.base.result import LOST, UPRIGHT
from jax_aero.stored import keep, kept
from jax_aero.stored.kept import Axis, Kept
from jax_aero.sweep import aggregate, columns, intervals, listing, populations, table
from jax_aero.sweep.criteria import Criterion, Share
from jax_aero.sweep.result import SweepResult
from jax_aero.sweep.spec import from_table

AXIS = {"name": "speed", "key": "wind.speed", "values": [0.0, 10.0, 18.0]}
CLAIM = Criterion(
    key="k", states="", at_most={"rotation_error_deg_p90_of_all": 10.0}, share=(Share(of="lost", at_most=0.3),)
)


def flights_of(outcomes, rotation, com=None):
    """The columns of flights that ended so, with these errors [deg, m]."""
    count = len(outcomes)
    outcomes = np.array(outcomes, dtype=object)
    is_lost = np.isin(outcomes, LOST)
    flights = dict.fromkeys(columns.FLIGHT, np.ones(count)) | {"outcome": outcomes}
    flights |= {"max_rotation_error_deg": np.array(rotation, float), "max_com_error": np.full(count, 0.02)}
    if com is not None:
        flights["max_com_error"] = np.array(com, float)
    return flights | {"lost_time": np.where(is_lost, 20.0, np.nan), "all_modes": np.zeros(count)}


def both_ways(flights, cells):
    """The cells of a sweep from its folder's tables, and from its kept file as it is read."""
    spec = from_table("made_up", {"title": "t", "base": "test2", "axis": [AXIS]})
    levels = [(level,) for level in spec.axes[0].levels][:cells]
    flown = pa.table({"speed": np.resize([level.label for (level,) in levels], len(flights["outcome"])), **flights})
    folder = table.cells(spec, levels, flown).to_pandas()
    axes = [Axis("speed", "speed", "m/s", [level.label for (level,) in levels])]
    rows = [
        [*at, *keep._shorten(list(found.values()))]
        for at, found in keep._rows(flown.to_pandas().assign(onset=18.0), axes, None)
    ]
    named = {"name": "made_up", "result": "", "title": "", "command": "", "created": "", "commit": None, "digest": ""}
    document = Kept(**named, axes=axes, columns=["speed", *aggregate.KEPT], rows=rows)
    stored = msgspec.json.decode(keep.to_json(document), type=Kept)
    assert stored.seal == kept.seal_of(stored)
    return SweepResult("made_up", {"axes": []}, folder).rows, stored.sweep.rows


def test_both_ways_have_the_same_figures_and_verdicts_of_drawn_flights():
    """Of any outcomes and errors, also without a flight that is upright, or with an error of position unknown."""
    rng = np.random.default_rng(1)
    ends = np.array([*UPRIGHT, *LOST], dtype=object)
    verdicts = set()
    for repeats in (1, 2, 7, 20, 41):
        for share in (0.0, 0.05, 0.4, 1.0):
            for _ in range(5):
                is_lost = rng.uniform(size=3 * repeats) < share
                outcomes = np.where(is_lost, rng.choice(ends[len(UPRIGHT) :], 3 * repeats), "completed")
                rotation, com = rng.uniform(0.0, 12.0, 3 * repeats), rng.uniform(0.0, 0.4, 3 * repeats)
                com[rng.uniform(size=3 * repeats) < 0.1] = np.nan
                folder, stored = both_ways(flights_of(outcomes, rotation, com), 3)
                for here, there in zip(folder, stored, strict=True):
                    for name in set(aggregate.KEPT) & set(columns.CELLS):
                        if here[name] is None or there[name] is None:
                            assert here[name] is there[name] is None, name
                        else:
                            assert here[name] == pytest.approx(there[name], rel=1e-4), name
                found = [
                    judge.of_sweep("s", CLAIM).judge(results.of_cells(cells, ["speed"], CLAIM).cases)
                    for cells in (folder, stored)
                ]
                assert found[0].kind == found[1].kind
                verdicts.add(found[0].kind)
    assert verdicts == {Kind.AGREES, Kind.IN_PART, Kind.DIFFERS}


def test_a_limit_of_nine_in_ten_counts_lost_flights_both_ways():
    """Eight flights at 5°, two fallen at 95°: few enough are lost, but nine in ten do not lean by 10° at most."""
    flights = flights_of(["completed"] * 8 + ["fell"] * 2, [5.0] * 8 + [95.0] * 2)
    for (cell,) in both_ways(flights, 1):
        assert cell["rotation_error_deg_p90_of_upright"] == pytest.approx(5.0)
        assert cell["rotation_error_deg_median_of_all"] == pytest.approx(5.0)
        assert cell["rotation_error_deg_p90_of_all"] == cell["rotation_error_deg_worst_of_all"] == np.inf
        verdict = judge.of_sweep("s", CLAIM).judge(results.of_cells([cell], [], CLAIM).cases)
        assert verdict.text.startswith("differs: k: lost")
    printed = listing.of_cells(pd.DataFrame([both_ways(flights, 1)[0][0]]).assign(lost=2), {})
    assert "5.00 (5.00 to lost)" in printed[1]


def test_a_figure_of_all_that_is_not_kept_decides_nothing():
    """Of rows kept before, in which some but few flights are lost."""
    flights = flights_of(["completed"] * 19 + ["fell"], [5.0] * 19 + [95.0])
    (cell,) = both_ways(flights, 1)[1]
    named = {"name": "made_up", "result": "", "title": "", "command": "", "created": "", "commit": None, "digest": ""}
    for value, kind in ((5.0, Kind.AGREES), (11.0, Kind.DIFFERS), ("lost", Kind.DIFFERS), (None, Kind.OUTDATED)):
        row = {name: cell[name] for name in aggregate.KEPT} | {"rotation_error_deg_p90_of_all": value}
        document = Kept(**named, columns=[*row], rows=[keep._shorten([*row.values()])])
        assert stored._find(document, CLAIM, "").verdict.kind is kind


def test_a_loss_never_improves_a_figure_of_all():
    """Each flight that is lost instead, wherever it was when it fell, leaves every quantile where it was or worse."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        rotation = rng.uniform(0.0, 40.0, 12)
        outcomes = ["completed"] * 12
        before = aggregate.figures(flights_of(outcomes, rotation))
        for lost in rng.permutation(12):
            outcomes[lost], rotation[lost] = "fell", rng.uniform(0.0, 90.0)
            after = aggregate.figures(flights_of(outcomes, rotation))
            for end in populations.QUANTILES:
                name = populations.quantile("max_rotation_error_deg", end, populations.OF_ALL)
                assert after[name] >= before[name]
            before = after


def test_every_quantile_names_the_flights_that_it_is_of():
    ends = [name for name in columns.CELLS if any(f"_{end}" in name for end in populations.QUANTILES)]
    assert ends
    assert all(name.endswith(tuple(populations.POPULATIONS)) for name in ends)
    assert {columns.CELLS[name].unit for name in ends} >= {"deg", "m", "s", "N"}


def test_a_quantile_between_a_number_and_a_loss_is_a_loss():
    values = np.array([1.0, 2.0, 3.0, np.inf])
    assert intervals.quantiles(values, [0.0, 0.5, 0.9, 1.0]).tolist() == [1.0, 2.5, np.inf, np.inf]
    assert intervals.quantiles(np.array([-np.inf, np.inf]), [0.0, 0.5, 1.0]).tolist() == [-np.inf, 0.0, np.inf]
    ramp = np.arange(21.0)
    assert intervals.quantiles(ramp, [0.1, 0.37]).tolist() == np.quantile(ramp, [0.1, 0.37]).tolist()


def test_a_kept_file_without_a_population_is_refused(monkeypatch, tmp_path):
    """A row of an older form says of no error which flights it is of."""
    document = Kept(
        name="old", result="", title="", command="", created="", commit=None, digest="",
        columns=["flights", "rotation_deg_high"], rows=[[10, 5.0]],
    )  # fmt: skip
    (tmp_path / "old.json").write_text(keep.to_json(document), encoding="utf-8")
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    with pytest.raises(kept.Refused, match=r"old\.json has no column `.*`: keep the result again"):
        kept.read("old")
