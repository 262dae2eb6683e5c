"""The gradient of a short flight with the predictive law by the law's weights."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from jax_aero import rust
from jax_aero.sim import begin, prepare, rollout

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
TICKS = 12
WEIGHTS = ("position", "attitude", "angular_velocity", "posture", "joint_command", "thrust_rate", "tail")


def test_gradient_by_weights(measured):
    """Of the errors of position and attitude after a gust, by each weight on its own, and by the decay of the tail."""
    table = rust.load_config(
        ROOT / "configs/experiments/test2_mpc.toml", {"wind.ramp_start": -1.0, "wind.ramp_end": 0.1}
    )
    scenario, start = prepare(table)
    mpc, state = scenario.controller.mpc, begin(scenario, start.plant)
    replace = dataclasses.replace

    @jax.jit
    @jax.value_and_grad
    def cost(p):
        weights = replace(mpc.weights, **{name: p[name] for name in WEIGHTS})
        changed = replace(scenario.controller, mpc=replace(mpc, weights=weights, decay=p["decay"]))

        def errors(row):
            return row.com_position - row.com_setpoint, row.rotation_error

        _, (com, angle) = rollout(replace(scenario, controller=changed), state, TICKS, errors)
        return 1e4 * jnp.sum(com**2) + 1e4 * jnp.sum(angle**2)

    at = {name: getattr(mpc.weights, name) for name in WEIGHTS} | {"decay": mpc.decay}
    _, slopes = cost(at)
    step = 1e-4
    for name, value in at.items():
        ahead, behind = (cost(at | {name: value * (1.0 + sign * step)})[0] for sign in (1.0, -1.0))
        slope = float(ahead - behind) / (2.0 * step)
        exact = float(jnp.vdot(slopes[name], value))
        assert exact != 0.0
        measured(
            f"slope by {name}",
            abs(exact - slope),
            1e-9 + 1e-5 * abs(slope),
            because="the error of the quotient, not of the derivative",
        )
