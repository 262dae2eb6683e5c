"""The benchmark of sweeps: what is computed from the times of its commands, and one of them."""

import pytest

from experiments.tools import bench_sweep as bench
from experiments.tools.bench_sweep import Cost
from jax_aero.base.terminal import Refused


def test_ticks_are_what_flights_of_one_tick_do_not_take():
    whole = Cost(flights=100, processor=1.5, wall=2.0, memory=300_000_000, disk=50_000, load=0.5)
    bare = Cost(flights=100, processor=0.3, wall=0.4, memory=200_000_000, disk=40_000, load=0.5)
    assert bench.of_flights(whole, bare) == pytest.approx(
        {
            "a second and core": 100 / 1.5,
            "a flight [ms]": 15.0,
            "beside its ticks [ms]": 3.0,
            "over its ticks'": 1.25,
            "memory [MB]": 300.0,
            "disk [kB]": 0.5,
        }
    )
    assert bench.of_overhead(bare) == pytest.approx({"a flight [ms]": 3.0, "memory [MB]": 200.0, "disk [kB]": 0.4})


def test_two_cores_and_more_flights_are_compared_by_wall_times():
    few = Cost(flights=100, processor=1.0, wall=2.0, memory=1, disk=1, load=0.5)
    many = Cost(flights=300, processor=1.1, wall=3.0, memory=1, disk=1, load=2.0)
    assert bench.of_more(few, many) == pytest.approx({"one more [ms]": 5.0, "load": 2.0})
    found = bench.of_cores(many, few)
    assert found == pytest.approx({"two cores / one": 2 / 3, "two cores / one, processor": 1 / 1.1, "load": 2.0})


def test_a_measured_sweep_has_a_cost():
    cost = bench.fly("test2", bench.TICK, 4)
    assert cost.flights == 4
    assert 0.0 < cost.processor < 2.0 * cost.wall
    assert cost.memory > 50e6
    assert 1000 < cost.disk < 1e6


def test_a_command_that_fails_is_refused_with_its_message():
    with pytest.raises(Refused, match="no_such_flight"):
        bench.fly("no_such_flight", bench.TICK, 4)
