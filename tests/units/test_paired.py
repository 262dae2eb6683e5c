"""Differences of shares and medians on the same draws, and tables as text, CSV and LaTeX."""

import numpy as np
import pandas as pd
import pytest

from jax_aero.base.terminal import Refused
from jax_aero.results.table import csv_table, latex_table, text_table
from jax_aero.sweep import aggregate, columns, listing, paired
from jax_aero.sweep.intervals import bootstrap, newcombe

ENDS = ("", "_low", "_high")


def test_an_interval_of_paired_shares_covers_their_difference():
    """Of pairs that agree in most draws, 95 % of the intervals do; those of unpaired shares would be twice as wide."""
    rng, covered, widths = np.random.default_rng(1), 0, []
    for _ in range(1000):
        draws = rng.uniform(size=60)
        _, low, high = newcombe(draws < 0.8, (draws < 0.7) ^ (rng.uniform(size=60) < 0.05))
        covered += low <= 0.8 - (0.95 * 0.7 + 0.05 * 0.3) <= high
        widths.append(high - low)
    assert 930 <= covered <= 985
    assert np.median(widths) < 0.65 * 3.92 * np.sqrt(2 * 0.7 * 0.3 / 60)
    first, second = np.repeat([True, False], (9, 1)), np.repeat([True, False], (6, 4))
    assert newcombe(first, second) == pytest.approx([-x for x in np.array(newcombe(second, first))[[0, 2, 1]]])


def test_a_median_lies_in_the_interval_of_its_bootstrap():
    values = np.random.default_rng(1).normal(1.0, 1.0, 400)
    median, low, high = bootstrap(values)
    assert low < median < high
    spread = 3.92 * 1.2533 / 20.0  # of the median of 400 normal values
    assert 0.6 * spread < high - low < 1.5 * spread
    assert np.isnan(bootstrap(values[:0])).all()


def test_flights_on_the_same_draws_are_pairs():
    """Errors follow the draws; `b` has half a degree and a centimetre more, in any order, and loses one flight."""
    draws = np.random.default_rng(1).uniform(5.0, 20.0, 8)
    both = pd.DataFrame({"law": np.repeat(["a", "b"], 8), "repeat": np.tile(np.arange(8), 2), "outcome": "completed"})
    both["max_rotation_error_deg"] = np.concatenate([draws, draws + 0.5])
    both["max_com_error"] = np.concatenate([draws, draws + 0.01])
    both.loc[11, "outcome"] = "fell"
    shuffled = both.iloc[[*range(8), *np.random.default_rng(2).permutation(np.arange(8, 16))]]
    (found,) = paired.differences(shuffled, ["law"], "law").to_dict("records")
    assert (found["law"], found["pairs"], found["share"]) == ("b − a", 8, -12.5)
    assert [found[f"rotation{end}"] for end in ENDS] == pytest.approx([0.5] * 3)
    assert [found[f"com{end}"] for end in ENDS] == pytest.approx([1.0] * 3)
    heading, row = listing.of_pairs(pd.DataFrame([found]), {"law": "control law"})
    assert (heading[0], row[0], row[3]) == ("control law", "b − a", "+0.50 (+0.50 to +0.50)")
    with pytest.raises(Refused, match="expected an axis with two levels or more, of law"):
        paired.differences(shuffled, ["law"], "wind")


def test_a_table_is_csv_and_latex():
    rows = [["gain $k_o$", "share [%]"], ['50_a, "b"', "−1°"]]
    assert csv_table(rows) == 'gain $k_o$,share [%]\n"50_a, ""b""",−1°'
    box, head, _, top, _, body, *_, end = latex_table(rows).splitlines()
    assert (box, end) == (r"\begin{adjustbox}{max width=16cm}", r"\end{adjustbox}")
    assert head == r"\begin{tabular}{ll}"
    assert top == r"gain $k_o$ & share [\%] \\"
    assert body == r'50\_a, "b" & \ensuremath{-}1\ensuremath{^\circ} \\'


def test_numbers_of_a_column_stand_below_each_other():
    rows = [["a", "share", "n"], ["x", "5 (1 to 12)", "5"], ["y", "", "−50"], ["3 of 4", "100 (-44 to 100)", ""]]
    _, head, _, _, _, first, second, third, *_ = latex_table(rows).replace(r"\phantom{0}", "_").splitlines()
    assert head == r"\begin{tabular}{lrr}"
    assert first == r"x & __5 (__1 to _12) & 5 \\"
    assert second == r"y &  & \ensuremath{-}50 \\"
    assert third == r"3 of 4 & 100 (\ensuremath{-}44 to 100) &  \\"
    assert text_table(rows).splitlines()[2] == "x         5 (  1 to  12)    5"


def test_a_table_of_cells_has_intervals_and_no_empty_column():
    """All flights of the second cell were lost before the position counts; no axis has a third level."""
    ends = {"median": [2.0, 60.0], "p10": [1.0, 50.0], "p90": [3.0, 90.0]}
    cells = pd.DataFrame({"law": ["a", "b"], "mass": [1.0, 2.5], "flights": 8, "upright": [8, 0]})
    cells = cells.assign(**dict.fromkeys(columns.OUTCOMES, 0)).assign(completed=[8, 0], fell=[0, 8])
    cells = cells.assign(**{f"rotation_error_deg_{end}": values for end, values in ends.items()})
    cells = cells.assign(**{f"com_error_{end}": [0.01 * values[0], None] for end, values in ends.items()})
    head, *rows = listing.of_cells(cells, {"law": "control law", "mass": "mass [kg]"})
    assert head[:5] == ("control law", "mass [kg]", "flights", "completed", "fell")
    assert rows == [
        ("a", "1", "8", "8", "0", "100 (68 to 100)", "2.00 (1.00 to 3.00)", "2.00 (1.00 to 3.00)"),
        ("b", "2.5", "8", "0", "8", "0 (0 to 32)", "60.00 (50.00 to 90.00)", ""),
    ]


def test_every_column_has_unit_and_meaning():
    cells = {"cell", *aggregate.figures({name: np.zeros(0) for name in columns.FLIGHT})}
    assert cells == {*columns.CELLS, *aggregate.KEPT} - {"found_s"}
    assert columns.CELLS["joint_error_sum_deg_median"][1:] == (
        "deg",
        "median over all flights that have it of: greatest sum of absolute joint errors",
    )
    assert columns.CELLS["com_error_worst"].unit == "m"
    assert not [name for name, of in {**columns.FLIGHTS, **columns.CELLS}.items() if of.unit == "rad"]
