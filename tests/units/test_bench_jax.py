"""The benchmark of the JAX twin measures functions of today: each of its cases but gradients can be traced."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import pytest

from experiments import bench_jax
from jax_aero import rust, sim
from jax_aero.base.typed import scenario_config

pytestmark = pytest.mark.usefixtures("x64")


def test_the_cases_of_ours_can_be_traced():
    scenario, start = sim.prepare(scenario_config(rust.load_config("test2")))
    traced = []
    for case in bench_jax.cases(scenario, start):
        if case.name.startswith("mjx."):  # from here on what others wrote
            break
        if not case.is_slow:
            jax.eval_shape(case.function, case.shared, case.sample)
            traced.append(case.name)
    assert {"kinematics, M, h, A_G (mjx)", "momentum QP, warm", "controller tick"} < set(traced)
    assert any("closed-loop" in name and "float32" in name for name in traced)


def test_what_is_asked_for_is_measured(monkeypatch, capsys):
    settings = {}
    config = SimpleNamespace(update=settings.__setitem__)
    monkeypatch.setattr(bench_jax, "untyped", SimpleNamespace(config=config))
    monkeypatch.setattr(bench_jax, "_hovering_flight", lambda: (None, None))
    named = [SimpleNamespace(name="kinematics", is_slow=False), SimpleNamespace(name="a gradient", is_slow=True)]
    monkeypatch.setattr(bench_jax, "cases", lambda *_: named)
    monkeypatch.setattr(bench_jax, "_row", lambda case, sizes, _: f"{case.name} {sizes}")
    monkeypatch.setattr(bench_jax, "_throughput", lambda *_, quick: [f"throughput {quick}"])

    def rows(*words):
        assert bench_jax.main(words) == 0
        return [
            line
            for line in capsys.readouterr().out.splitlines()
            if line and not line.startswith(("|", "Device", "The"))
        ]

    assert rows("--only", "kin") == ["kinematics [1, 64, 1024]"]
    assert rows("--quick") == ["kinematics [1, 64]", "throughput True"]
    assert rows("--batch", "3") == ["kinematics [3]", "a gradient [3]", "throughput False"]
    assert settings["jax_enable_x64"] is True


def test_a_row_has_times_per_item_and_of_compiling_with_and_without_the_cache(monkeypatch):
    compiled = iter([0.25, 0.75, 0.5])  # at two sizes, then again from the cache
    untyped = SimpleNamespace(block_until_ready=lambda _: None, clear_caches=lambda: None)
    monkeypatch.setattr(bench_jax, "untyped", untyped)
    monkeypatch.setattr(bench_jax, "_compile", lambda *_: (lambda *_: None, next(compiled)))
    monkeypatch.setattr(bench_jax, "_median", lambda call, _: call() or 8e-6)
    case = SimpleNamespace(name="made up", sample=0.0, shared=None, divide_by=2)
    assert bench_jax._row(case, [1, 4], 0.0) == "| made up | 4.0 µs | 1.0 µs | 0.8 s | 0.5 s |"
