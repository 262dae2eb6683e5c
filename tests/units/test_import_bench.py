"""Logs of turbines become datasets: columns, gaps, clipped rows, and refusals with line and column."""

import numpy as np
import pytest

from jax_aero.base.terminal import Refused
from jax_aero.data import import_bench
from jax_aero.data.import_bench import load_bench, read_bench

TABLE = """time_s,speed_rpm,thrust_n,clipped
0.0,33000,12.5,0
0.1,,13.0,0
0.35,36000,195.0,1
"""


def test_a_table_becomes_a_dataset(tmp_path, capsys):
    (tmp_path / "p100.csv").write_text(TABLE)
    assert import_bench.main([str(tmp_path / "p100.csv"), "--out", str(tmp_path / "a.nc")]) == 0
    assert "3 rows, speed, thrust; sha256" in capsys.readouterr().out
    bench = load_bench(tmp_path / "a.nc")
    np.testing.assert_array_equal(bench.time, [0.0, 0.1, 0.35])
    np.testing.assert_array_equal(bench.speed, [33000.0, np.nan, 36000.0])
    np.testing.assert_array_equal(bench.thrust, [12.5, 13.0, np.nan])
    assert np.isnan(bench.throttle).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,force\n0,1\n", "has the columns time_s, force; expected time_s and any of throttle_percent"),
        ("time_s,thrust_n\n0,1\n0,2\n", "column time_s in line 3 of a.csv is 0.0; expected ascending times"),
        ("time_s,thrust_n\n0,1;5\n", "column thrust_n in line 2 of a.csv is 1;5; expected a finite number, or nothing"),
        ("time_s,thrust_n\n0,inf\n", "column thrust_n in line 2 of a.csv is inf; expected a finite number, or nothing"),
        ("time_s,thrust_n\n0,1\n", "1 rows; expected 2 or more"),
        ("time_s,thrust_n,thrust_n\n0,1,2\n", "column thrust_n of a.csv is there twice"),
    ],
)
def test_what_is_no_log_is_refused(text, words):
    with pytest.raises(Refused, match=words):
        read_bench(text, "a.csv")
