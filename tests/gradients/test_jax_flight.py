"""The gradient of two seconds of closed loop against difference quotients, and what a loss leaves of it.

The simulator has a network, jets with throttles and a recorded reference, so that one compilation serves all of them.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.sim import begin, prepare, rollout

pytestmark = pytest.mark.usefixtures("x64")

TICKS = 200
PARAMETERS = (
    *("kp_linear", "kd_linear", "c0", "c1", "torque_kd", "posture_gain"),
    *("network_scale", "modelled_areas", "engine_gain", "wind", "velocity", "joint_position"),
)


@pytest.fixture(scope="module")
def problem(x64, tmp_path_factory):
    """A cost of tracking as long as the flight lasts: compiled, and its value with the gradient."""
    table = rust.load_config("test2")
    table["wind"] |= {"ramp_start": -1.0, "ramp_end": 0.5}
    table["simulator"]["jets"] = {"dynamics": "throttled"}
    network = rust.load_config("test4")["simulator"]["aero"]
    table["simulator"]["aero"] = network | {"precision": "f64"}
    table["mission"] = {"file": str(tmp_path_factory.mktemp("reference") / "sway.csv")}
    first = rust.fly(table | {"mission": {}, "simulator": table["simulator"] | {"duration": 0.01}})
    times = np.arange(0.0, 3.0, 0.05)
    com = first["com_setpoint"][0] + 0.02 * np.stack([np.sin(times), 1.0 - np.cos(times), 0.0 * times], axis=1)
    rows = np.column_stack([times, com, np.tile(first["base_rpy_setpoint"][0], (len(times), 1))])
    np.savetxt(table["mission"]["file"], rows, delimiter=",", header="time,x,y,z,roll,pitch,yaw", comments="")
    scenario, start = prepare(table)
    controller, robot_state = scenario.controller, start.plant.robot
    at = {
        "kp_linear": controller.momentum.kp_linear,
        "kd_linear": controller.momentum.kd_linear,
        "c0": controller.momentum.c0,
        "c1": controller.momentum.c1,
        "torque_kd": controller.torque.kd,
        "posture_gain": controller.tasks.posture_gain,
        "network_scale": scenario.plant.aero.network.scale.astype(np.float64),
        "modelled_areas": controller.aero.areas,
        "engine_gain": scenario.plant.jets.engines.b_u,
        "wind": scenario.wind.velocity,
        "velocity": robot_state.velocity,
        "joint_position": robot_state.joint_position,
        "com_error": scenario.fall.com_error,
    }

    def cost(p):
        replace = dataclasses.replace
        gains = {name: p[name] for name in ("kp_linear", "kd_linear", "c0", "c1")}
        changed = replace(
            controller,
            momentum=replace(controller.momentum, **gains),
            torque=replace(controller.torque, kd=p["torque_kd"]),
            tasks=controller.tasks._replace(posture_gain=p["posture_gain"]),
            aero=replace(controller.aero, areas=p["modelled_areas"]),
        )
        plant = scenario.plant
        engines = plant.jets.engines._replace(b_u=p["engine_gain"])
        air = replace(plant.aero, network=replace(plant.aero.network, scale=p["network_scale"]))
        perturbed = replace(
            scenario,
            plant=replace(plant, aero=air, jets=replace(plant.jets, engines=engines)),
            controller=changed,
            wind=replace(scenario.wind, velocity=p["wind"]),
            fall=replace(scenario.fall, com_error=p["com_error"]),
        )
        first = robot_state._replace(velocity=p["velocity"], joint_position=p["joint_position"])
        state = begin(perturbed, start.plant._replace(robot=first))

        def errors(row):
            return (
                row["com_position"] - row["com_setpoint"],
                row["rotation_error"],
                row["thrust"] - 100.0,
                row["qp_status"],
            )

        after, (com, angle, thrust, status) = rollout(perturbed, state, TICKS, errors)
        flies = (after.loss_tick < 0) | (jnp.arange(TICKS) < after.loss_tick)
        squares = jnp.sum(com**2, axis=1) + angle**2 + 1e-6 * jnp.sum(thrust**2, axis=1)
        return jnp.sum(jnp.where(flies, squares, 0.0)), (status, after.loss_tick)

    return at, jax.jit(cost), jax.jit(jax.value_and_grad(jax.checkpoint(cost), has_aux=True))


def test_gradient_of_a_closed_loop(problem, measured):
    """With respect to gains, coefficients of either side, engine, wind and the first state, each on its own."""
    at, cost, value_and_gradient = problem
    (_, (status, loss_tick)), slopes = value_and_gradient(at)
    assert loss_tick == -1
    assert np.all(status == 0)
    rng, step = np.random.default_rng(0), 1e-5
    for name in PARAMETERS:
        along = rng.normal(size=at[name].shape) * np.maximum(np.abs(at[name]), 0.02)
        ahead, behind = (cost(at | {name: at[name] + s * step * along})[0] for s in (1.0, -1.0))
        exact = float(jnp.vdot(slopes[name], along))
        slope = float(ahead - behind) / (2 * step)
        measured(
            f"slope by {name}",
            abs(exact - slope),
            1e-9 + 1e-5 * abs(slope),
            because="the error of the quotient, not of the derivative",
        )


@pytest.mark.parametrize(
    ("change", "tick"),
    [
        ({"com_error": 0.004}, None),
        ({"velocity": np.full(29, np.nan)}, 0),
        ({"velocity": np.full(29, 1e8)}, 0),
        ({"wind": np.full(3, np.nan)}, 0),
    ],
    ids=["lost", "state not finite", "too fast", "wind not finite"],
)
def test_gradient_of_a_flight_that_is_lost(problem, change, tick, measured):
    """Of what was recorded until then: finite, so that one bad sample does not spoil the gradient of a batch."""
    at, cost, value_and_gradient = problem
    changed = at | {name: np.asarray(value, np.float64) for name, value in change.items()}
    (value, (_, loss_tick)), slopes = value_and_gradient(changed)
    assert loss_tick == tick if tick is not None else 0 < loss_tick < TICKS
    assert np.isfinite(value)
    for name, slope in slopes.items():
        assert np.all(np.isfinite(slope)), name
    if tick is None:
        # The slope of a sum up to a loss, along a direction that does not move the loss to another tick.
        ahead, behind = (cost(changed | {"c0": at["c0"] * (1 + s * 1e-5)}) for s in (1.0, -1.0))
        assert ahead[1][1] == behind[1][1] == loss_tick
        difference = float(ahead[0] - behind[0]) / 2e-5
        measured(
            "slope by c0",
            abs(float(slopes["c0"] * at["c0"]) - difference),
            1e-9 + 1e-5 * abs(difference),
            because="the error of the quotient",
        )
