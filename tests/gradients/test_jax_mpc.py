"""Derivatives by the weights of the predictive law: of one plan in both modes, of a short flight along its ticks."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.control import qp
from jax_aero.control.measurement import Measurement
from jax_aero.control.mpc.horizon import Target, horizon
from jax_aero.control.mpc.model import linearise
from jax_aero.sim import begin, prepare, rollout

pytestmark = pytest.mark.usefixtures("x64")

TICKS = 12
WEIGHTS = ("position", "attitude", "angular_velocity", "posture", "joint_command", "thrust_rate", "tail")


def prepared():
    """The predictive law without an observer, which would only take time."""
    table = rust.load_config("test2", {"wind.ramp_start": -1.0, "wind.ramp_end": 0.1})
    table["controller"]["mpc"] = rust.load_config("test2_mpc")["controller"]["mpc"]
    return prepare(table)


def weighted(mpc, p):
    weights = dataclasses.replace(mpc.weights, **{name: p[name] for name in WEIGHTS})
    return dataclasses.replace(mpc, weights=weights, **{name: p[name] for name in p if name not in WEIGHTS})


def test_gradient_of_a_plan(check_gradient):
    """By weights and by what the model says, with thrusts, joints and a distance within their limits and beyond."""
    scenario, start = prepared()
    params, robot, state = scenario.controller, scenario.plant.robot, start.plant.robot
    mpc, gains = params.mpc, (params.torque.kd, params.torque.kp)
    rng = np.random.default_rng(3)
    thrust, wind = np.array([60.0, 70.0, 150.0, 110.0]), np.array([2.0, -9.0, 1.0])
    now = Measurement(jnp.zeros(()), state, thrust, wind)
    target = Target(*0.3 * rng.normal(size=(6, len(mpc.structure.durations), 3)))

    @jax.jit
    def at_state():
        model = params.model(robot, now)
        return model, linearise(robot, params.aero, mpc.structure.air, mpc.structure.joints, state, thrust, wind)

    model, linear = at_state()

    def plan(at, beyond):
        changed = weighted(mpc, at["weights"])
        wrenches = jnp.zeros((len(mpc.structure.durations), 6))
        ahead = horizon(changed, None, gains, robot, at["linear"], now, model, state.joint_position, target, wrenches)
        u = qp.solve(ahead.problem(beyond, jnp.full(ahead.g.shape, -40.0), jnp.full(ahead.g.shape, 40.0))).x
        return {"u": u, "values": ahead.free + ahead.changes(u)}

    at = {name: getattr(mpc.weights, name) for name in WEIGHTS}
    at |= {name: getattr(mpc, name) for name in ("decay", "thrust_excess", "clearance")}
    of_knot = thrust.size + len(mpc.structure.joints) + len(mpc.clearance.pairs)
    beyond = np.zeros((len(mpc.structure.durations), of_knot), np.int8)
    some_are = beyond.copy()
    some_are[:, [2, 7]], some_are[:, 20] = 1, -1
    for some in (beyond.ravel(), some_are.ravel()):
        check_gradient(plan, {"weights": at, "linear": linear}, some, tolerance=1e-5)


@pytest.mark.slow
def test_slopes_of_a_flight(measured):
    """Of the errors of position and attitude after a gust, by each weight on its own, and by the decay of the tail."""
    scenario, start = prepared()
    mpc, state = scenario.controller.mpc, begin(scenario, start.plant)

    def cost(p):
        changed = dataclasses.replace(scenario.controller, mpc=weighted(mpc, p))

        def errors(row):
            return row["com_position"] - row["com_setpoint"], row["rotation_error"]

        _, (com, angle) = rollout(dataclasses.replace(scenario, controller=changed), state, TICKS, errors)
        return 1e4 * jnp.sum(com**2) + 1e4 * jnp.sum(angle**2)

    slope_along = jax.jit(lambda p, along: jax.jvp(cost, (p,), (along,)))
    at = {name: jnp.asarray(getattr(mpc.weights, name)) for name in WEIGHTS} | {"decay": jnp.asarray(mpc.decay)}
    none, step = jax.tree.map(jnp.zeros_like, at), 1e-4
    for name, value in at.items():
        along = none | {name: value}
        _, exact = slope_along(at, along)
        ahead, behind = (slope_along(at | {name: value * (1.0 + sign * step)}, along)[0] for sign in (1.0, -1.0))
        slope = float(ahead - behind) / (2.0 * step)
        assert exact != 0.0
        measured(
            f"slope by {name}",
            abs(float(exact) - slope),
            1e-9 + 1e-5 * abs(slope),
            because="the error of the quotient, not of the derivative",
        )
