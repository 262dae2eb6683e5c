"""The summary of what tests measure: a line, and on request each figure and what uses much of its tolerance."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests import measurements
from tests.measurements import Measurement


@pytest.mark.parametrize("is_asked", [False, True])
def test_tolerances_are_listed_where_asked(is_asked, monkeypatch):
    monkeypatch.delenv("MEASURED", raising=False)
    close = Measurement("t.py::a", "near", 0.5, 1.0, ""), Measurement("t.py::b", "explained", 0.2, 1.0, "it rounds")
    monkeypatch.setattr(measurements, "_measurements", [*close, Measurement("t.py::c", "far", 0.01, 1.0, "")])
    monkeypatch.setattr(measurements, "_figures", {("t", "size"): 3.0})
    lines = []
    reporter = SimpleNamespace(section=lines.append, write_line=lines.append)
    config = SimpleNamespace(getoption=lambda name, default: is_asked if name == "--tolerances" else default)
    measurements.pytest_terminal_summary(reporter, config)
    title = "2 of 3 measurements use more than 10% of their tolerance"
    if not is_asked:
        assert lines == [f"{title} (listed by --tolerances)"]
        return
    listed = ["t.py::a: near: 0.5 of 1: NO REASON STATED", "t.py::b: explained: 0.2 of 1: it rounds"]
    assert lines == ["figures", "t  size  3.0e+00", title, *listed]
