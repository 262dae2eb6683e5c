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
    assert [found[name] for name in ("lost_before", "lost_after", "lost_both")] == [0, 1, 0]
    assert (found["rotation_of_upright_pairs"], found["com_of_upright_pairs"]) == (7, 7)
    assert [found[f"rotation_of_upright{end}"] for end in ENDS] == pytest.approx([0.5] * 3)
    assert [found[f"com_of_upright{end}"] for end in ENDS] == pytest.approx([1.0] * 3)
    assert [found[f"rotation{end}"] for end in ENDS[:2]] == pytest.approx([0.5] * 2)
    heading, row = listing.of_pairs(pd.DataFrame([found]), {"law": "control law"})
    shown = dict(zip(heading, row, strict=True))
    assert (shown["control law"], shown["pairs"], shown["in the other alone"]) == ("b − a", "8", "1")
    assert shown[paired.COLUMNS["rotation_of_upright"]] == "+0.50 (+0.50 to +0.50)"
    assert shown[paired.COLUMNS["rotation"]].startswith("+0.50 (+0.50 to ")
    with pytest.raises(Refused, match="expected an axis with two levels or more, of law"):
        paired.differences(shuffled, ["law"], "wind")


def test_a_pair_of_which_a_flight_is_lost_counts_in_the_median():
    """Of ten pairs seven lean 2.6° less and three fall at 60°, six of them or all: the loss decides, not 2.6°."""

    def compared(lost_before, lost_after):
        frame = pd.DataFrame({"law": np.repeat(["a", "b"], 10), "repeat": np.tile(np.arange(10), 2)})
        frame["max_rotation_error_deg"] = np.repeat([10.0, 7.4], 10)
        frame["max_com_error"] = 0.02
        frame["outcome"] = "completed"
        for first, which in ((0, lost_before), (10, lost_after)):
            frame.loc[[first + number for number in which], ["outcome", "max_rotation_error_deg"]] = ("fell", 60.0)
        return paired.differences(frame, ["law"], "law").to_dict("records")[0]

    three = compared([], [0, 1, 2])
    assert (three["pairs"], three["lost_after"], three["rotation_of_upright_pairs"]) == (10, 3, 7)
    assert three["rotation"] == three["rotation_of_upright"] == pytest.approx(-2.6)
    assert three["rotation_high"] == np.inf
    assert three["rotation_of_upright_high"] == pytest.approx(-2.6)
    six = compared([], range(6))
    assert (six["rotation"], six["rotation_of_upright"]) == (np.inf, pytest.approx(-2.6))
    heading, row = listing.of_pairs(pd.DataFrame([six]), {"law": "control law"})
    assert "+lost (" in row[heading.index(paired.COLUMNS["rotation"])]
    assert compared(range(6), [])["rotation"] == -np.inf
    both = compared(range(10), range(10))
    assert (both["lost_both"], both["rotation"], both["rotation_of_upright_pairs"]) == (10, 0.0, 0)
    assert np.isnan(both["rotation_of_upright"])


def test_a_table_is_csv_and_latex():
    rows = [["gain $k_o$", "share [%]"], ['50_a, "b"', "−1°"]]
    assert csv_table(rows) == 'gain $k_o$,share [%]\n"50_a, ""b""",−1°'
    box, head, _, top, _, body, *_, end = latex_table(rows).splitlines()
    assert (box, end) == (r"\begin{adjustbox}{max width=16cm}", r"\end{adjustbox}")
    assert head == r"\begin{tabular}{ll}"
    assert top == r"gain $k_o$ & share [\%] \\"
    assert body == r'50\_a, "b" & \ensuremath{-}1\ensuremath{^\circ} \\'


def test_parts_of_a_heading_stand_one_below_the_other_in_latex():
    rows = [["law, $k(a, b)$", "error [cm], median, 10 to 90 %"], ["a", "5 (1 to 12)"]]
    _, _, _, top, *_ = latex_table(rows).splitlines()
    assert top == r"\shortstack[l]{law,\\$k(a, b)$} & \shortstack[r]{error [cm],\\median,\\10 to 90 \%} \\"


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
    cells = cells.assign(**{f"rotation_error_deg_{end}_of_all": [values[0], np.inf] for end, values in ends.items()})
    cells = cells.assign(**{f"com_error_{end}_of_all": [0.01 * values[0], None] for end, values in ends.items()})
    head, *rows = listing.of_cells(cells, {"law": "control law", "mass": "mass [kg]"})
    assert head[:5] == ("control law", "mass [kg]", "flights", "completed", "fell")
    assert rows == [
        ("a", "1", "8", "8", "0", "100 (68 to 100)", "2.00 (1.00 to 3.00)", "2.00 (1.00 to 3.00)"),
        ("b", "2.5", "8", "0", "8", "0 (0 to 32)", "lost (lost to lost)", ""),
    ]


def test_every_column_has_unit_and_meaning():
    cells = {"cell", *aggregate.figures({name: np.zeros(0) for name in columns.FLIGHT})}
    assert cells == {*columns.CELLS, *aggregate.KEPT} - {"found_s"}
    assert columns.CELLS["joint_error_sum_deg_median_of_upright"][1:] == (
        "deg",
        "median, over the flights that completed or landed, of: greatest sum of absolute joint errors",
    )
    assert columns.CELLS["com_error_worst_of_all"].unit == "m"
    assert not [name for name, of in {**columns.FLIGHTS, **columns.CELLS}.items() if of.unit == "rad"]
