"""The gradient of two seconds of closed loop against difference quotients."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.config import flight_config
from jax_aero.robot import load_robot
from jax_aero.sim import begin, prepare, rollout

pytestmark = pytest.mark.usefixtures("x64")

ROOT = Path(__file__).resolve().parents[2]
TICKS = 200
PARAMETERS = (
    *("kp_linear", "kd_linear", "c0", "c1", "torque_kd", "posture_gain"),
    *("simulated_areas", "believed_areas", "velocity", "joint_position"),
)


@pytest.fixture(scope="module")
def problem(x64):
    """A cost of tracking, as a function of all parameters and initial values, and its compiled value and gradient."""
    wind = {"wind.ramp_start": -1.0, "wind.ramp_end": 0.5}
    config = flight_config(rust.load_config(ROOT / "configs" / "experiments" / "test2.toml", wind))
    flight, start = prepare(config, load_robot(config.robot))
    controller, robot_state = flight.controller, start.plant.robot
    at = {
        "kp_linear": controller.momentum.kp_linear,
        "kd_linear": controller.momentum.kd_linear,
        "c0": controller.momentum.c0,
        "c1": controller.momentum.c1,
        "torque_kd": controller.torque.kd,
        "posture_gain": controller.tasks.posture_gain,
        "simulated_areas": flight.plant.aero.areas,
        "believed_areas": controller.aero.areas,
        "velocity": robot_state.velocity,
        "joint_position": robot_state.joint_position,
    }

    def cost(p):
        gains = {name: p[name] for name in ("kp_linear", "kd_linear", "c0", "c1")}
        changed = dataclasses.replace(
            controller,
            momentum=dataclasses.replace(controller.momentum, **gains),
            torque=dataclasses.replace(controller.torque, kd=p["torque_kd"]),
            tasks=controller.tasks._replace(posture_gain=p["posture_gain"]),
            aero=dataclasses.replace(controller.aero, areas=p["believed_areas"]),
        )
        world = dataclasses.replace(
            flight.plant, aero=dataclasses.replace(flight.plant.aero, areas=p["simulated_areas"])
        )
        perturbed = dataclasses.replace(flight, plant=world, controller=changed)
        first = robot_state._replace(velocity=p["velocity"], joint_position=p["joint_position"])
        state = begin(perturbed, start.plant._replace(robot=first))

        def errors(row):
            return row.com_position - row.com_reference, row.rotation_error, row.thrust - 100.0, row.qp_status

        _, (com, angle, thrust, status) = rollout(perturbed, state, TICKS, errors)
        return jnp.sum(com**2) + jnp.sum(angle**2) + 1e-6 * jnp.sum(thrust**2), status

    # One compiled function for both: compiling the cost once more would take longer than a few gradients too many.
    return at, jax.jit(jax.value_and_grad(cost, has_aux=True))


def test_gradient_of_a_closed_loop(problem):
    """With respect to gains, aerodynamic coefficients of either side and the first state, each on its own."""
    at, value_and_gradient = problem
    (_, status), slopes = value_and_gradient(at)
    assert np.all(status == 0)
    rng, step = np.random.default_rng(0), 1e-5
    for name in PARAMETERS:
        along = rng.normal(size=at[name].shape) * np.maximum(np.abs(at[name]), 0.02)
        ahead, behind = (value_and_gradient(at | {name: at[name] + s * step * along})[0][0] for s in (1.0, -1.0))
        exact = float(jnp.vdot(slopes[name], along))
        assert exact == pytest.approx(float(ahead - behind) / (2 * step), rel=1e-5, abs=1e-9), name
