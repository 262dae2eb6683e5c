"""The benchmark beside other libraries; what it measures is in `docs/benchmarks.md`."""

from __future__ import annotations

from experiments import bench
from jax_aero import files


def test_a_second_benchmark_at_the_same_time_is_refused(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(bench, "FOLDER", tmp_path / "side_by_side")
    with files.lock_work(bench.FOLDER):
        assert bench.main([]) == 2
    assert "side_by_side.work is being written by process" in capsys.readouterr().err
