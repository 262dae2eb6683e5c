"""The benchmark of the JAX twin measures functions of today: each of its cases can be traced."""

from __future__ import annotations

import jax
import pytest

from experiments.tools import bench_jax
from jax_aero import rust, sim
from jax_aero.base.typed_config import scenario_config

pytestmark = pytest.mark.usefixtures("x64")


def test_the_cases_can_be_traced():
    scenario, start = sim.prepare(scenario_config(rust.load_config("test2")))
    cases = list(bench_jax.cases(scenario, start))
    for case in cases:
        jax.eval_shape(case.function, case.shared, case.sample)
    assert len(cases) == 5
