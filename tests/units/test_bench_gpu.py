"""The benchmark of a GPU that is not there: what it counts in a program, and when it names one as slower."""

from types import SimpleNamespace

import pytest

from experiments.tools import bench_gpu as bench

PROGRAM = """HloModule jit_run, is_scheduled=true

%qp (inner: (f32[8,2])) -> (f32[8,2]) {
  %inner = (f32[8,2]{1,0}) parameter(0)
  %y = f32[8,2]{1,0} get-tuple-element(%inner), index=0
  %factor = (f32[8,2]{1,0}, /*index=1*/s32[8]{0}) custom-call(%y), custom_call_target="cusolver_potrf_ffi"
  ROOT %next = (f32[8,2]{1,0}) tuple(%y)
}

%tick (state: (s32[], f32[8,2], f32[100,8])) -> (s32[], f32[8,2], f32[100,8]) {
  %state = (s32[], f32[8,2]{1,0}, f32[100,8]{1,0}) parameter(0)
  %x = f32[8,2]{1,0} get-tuple-element(%state), index=1
  %rows = f32[100,8]{1,0} get-tuple-element(%state), index=2
  %fusion.1 = f32[100,8]{1,0} fusion(%rows, %x), kind=kLoop, calls=%fused
  %search = (f32[8,2]{1,0}) while(%start), condition=%goes_on, body=%qp
  ROOT %after = (s32[], f32[8,2]{1,0}, f32[100,8]{1,0}) tuple(%count, %x, %fusion.1)
}

ENTRY %main (x: f32[8,2]) -> f32[8,2] {
  %x.1 = f32[8,2]{1,0} parameter(0)
  %copy = f32[8,2]{1,0} copy(%x.1)
  ROOT %while.1 = (s32[], f32[8,2]{1,0}) while(%copy), body=%tick, backend_config={"known_trip_count":{"n":"100"}}
}
"""


def test_kernels_calls_and_bytes_are_counted_loop_by_loop():
    main = bench.read(PROGRAM)
    (tick,) = main.inner
    (qp,) = tick.inner
    assert (main.kernels, main.calls, main.moved) == (1, 0, 128)
    # An entry of a row of 8 numbers, read and written, and 16 numbers.
    assert (tick.passes, tick.kernels, tick.calls, tick.moved) == (100, 1, 0, 4 * (8 + 8 + 16))
    assert (qp.passes, qp.kernels, qp.calls, qp.moved) == (None, 0, 1, 4 * (16 + 8 + 16))
    assert tick.least == pytest.approx(2.5e-6 + 128 / 4.8e12)


@pytest.mark.parametrize(
    ("text", "reason"), [("HloModule a", "no entry"), (PROGRAM.replace("fusion(", "call("), "fusion.1 is a call")]
)
def test_what_is_not_understood_is_refused(text, reason):
    with pytest.raises(ValueError, match=reason):
        bench.read(text)


def test_without_the_packages_nothing_is_compiled(monkeypatch, capsys):
    monkeypatch.setattr(bench.importlib.util, "find_spec", lambda _: None)
    assert bench.main([]) == 0
    assert "are not installed" in capsys.readouterr().out


def test_a_program_that_takes_more_than_is_stored_is_named(monkeypatch):
    stored = {"a tick": dict.fromkeys(bench.COMPARED, 100.0)}
    monkeypatch.setattr(bench.kept, "read", lambda _: SimpleNamespace(summary=stored))
    assert bench.above(stored) == []
    found = {"a tick": stored["a tick"] | {"kernels": 106.0}, "another": {"kernels": 1.0}}
    assert bench.above(found) == ["a tick, kernels", "another, kernels"]


def test_a_tick_takes_the_passes_of_the_slowest_robot(monkeypatch):
    """The least time is that of the tick and of two and a half passes of its QP."""
    compiled = SimpleNamespace(
        as_text=lambda: PROGRAM,
        memory_analysis=lambda: SimpleNamespace(temp_size_in_bytes=8 * bench.BATCH * bench.TICKS),
    )
    monkeypatch.setattr(bench, "compile_for_h200", lambda *_: compiled)
    passes = {name: {bench.OWN: 1.0, bench.SLOWEST: 2.5} for name in bench.QPS}
    found = bench._of_program(bench.ENVIRONMENT, lambda _: (None, lambda: ()), passes)[bench.ENVIRONMENT]
    (tick,) = bench.read(PROGRAM).inner
    assert found["at least [ms]"] == pytest.approx(1e3 * tick.least)
    assert found["with QPs, at least [ms]"] == pytest.approx(1e3 * (tick.least + 2.5 * tick.inner[0].least))
    assert found["workspace of a tick [kB a robot]"] == pytest.approx(8e-3)
