"""Differences of shares and medians on the same draws, and tables as text, CSV and LaTeX."""

import numpy as np
import pandas as pd
import pytest

from experiments import Refused
from experiments.sweep import columns, paired, table
from experiments.table import csv_table, latex_table


def test_an_interval_of_paired_shares_covers_their_difference():
    """Of pairs that agree in most draws, 95 % of the intervals do; those of unpaired shares would be twice as wide."""
    rng, covered, widths = np.random.default_rng(1), 0, []
    for _ in range(1000):
        draws = rng.uniform(size=60)
        _, low, high = paired.newcombe(draws < 0.8, (draws < 0.7) ^ (rng.uniform(size=60) < 0.05))
        covered += low <= 0.8 - (0.95 * 0.7 + 0.05 * 0.3) <= high
        widths.append(high - low)
    assert 930 <= covered <= 985
    assert np.median(widths) < 0.65 * 3.92 * np.sqrt(2 * 0.7 * 0.3 / 60)
    first, second = np.repeat([True, False], (9, 1)), np.repeat([True, False], (6, 4))
    assert paired.newcombe(first, second) == pytest.approx(
        [-x for x in np.array(paired.newcombe(second, first))[[0, 2, 1]]]
    )


def test_a_median_lies_in_the_interval_of_its_bootstrap():
    values = np.random.default_rng(1).normal(1.0, 1.0, 400)
    median, low, high = paired.bootstrap(values)
    assert low < median < high
    spread = 3.92 * 1.2533 / 20.0  # of the median of 400 normal values
    assert 0.6 * spread < high - low < 1.5 * spread
    assert np.isnan(paired.bootstrap(values[:0])).all()


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
    assert [found[f"rotation{end}"] for end in paired.ENDS] == pytest.approx([0.5] * 3)
    assert [found[f"com{end}"] for end in paired.ENDS] == pytest.approx([1.0] * 3)
    heading, row = paired.listing(pd.DataFrame([found]), {"law": "control law"})
    assert (heading[0], row[0], row[3]) == ("control law", "b − a", "+0.5 (+0.5 to +0.5)")
    with pytest.raises(Refused, match="expected an axis with two levels or more, of law"):
        paired.differences(shuffled, ["law"], "wind")


def test_a_table_is_csv_and_latex():
    rows = [["gain $k_o$", "share [%]"], ['50_a, "b"', "−1°"]]
    assert csv_table(rows) == 'gain $k_o$,share [%]\n"50_a, ""b""",−1°'
    head, _, top, _, body, *_ = latex_table(rows).splitlines()
    assert head == r"\begin{tabular}{ll}"
    assert top == r"gain $k_o$ & share [\%] \\"
    assert body == r'50\_a, "b" & \ensuremath{-}1\ensuremath{^\circ} \\'


def test_every_column_has_unit_and_meaning():
    cells = {"cell", *table._cell({name: np.zeros(0) for name, _ in table.FLIGHT})}
    assert cells == set(columns.CELLS)
    assert {name for name, _ in (*table.PLACE, table.DRAWN, *table.FLIGHT)} == set(columns.FLIGHTS)
    assert columns.CELLS["joint_error_sum_deg_median"] == ("deg", "median of: greatest sum of absolute joint errors")
    assert columns.CELLS["com_error_worst"][0] == "m"
    assert not [name for name, (unit, _) in (columns.FLIGHTS | columns.CELLS).items() if unit == "rad"]
