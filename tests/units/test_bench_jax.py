"""The benchmark of the JAX twin measures functions of today: each of its cases but gradients can be traced."""

from __future__ import annotations

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
