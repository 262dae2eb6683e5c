"""What acts on the simulated robot, term by term: the plant in JAX and the crate's, under the same commands."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.types import Array, pytree

pytestmark = pytest.mark.usefixtures("x64")

TICKS = 16
STILL = {
    "simulator.duration": 1.0,
    "simulator.aero": {"model": "off"},
    "simulator.substeps": 4,
    "simulator.initial.free_fall_tick": False,
    "simulator.joint_stops": False,
}
MOTORS = {"friction": 0.5, "damping": 0.5, "inertia": 0.05}
FAILURE = {"jet": "l_arm_jet", "time": 0.08, "kind": "stuck"}
ERRORS = {"mass_scale": 1.1, "inertia_scale": 0.8, "com_offset": [0.01, 0.0, -0.02]}
CASES = {
    "nothing": {},
    "stops": {"simulator.joint_stops": True},
    "explicit": {"simulator.integrator": "explicit_euler"},
    "rotors": {"simulator.motors": MOTORS | {"friction": 0.0, "damping": 0.0}},
    "friction": {"simulator.motors": MOTORS | {"damping": 0.0, "friction_of": {"l_elbow": 3.0, "r_knee": 0.0}}},
    "friction under load": {"simulator.motors": MOTORS | {"load_friction": {"l_elbow": 0.4, "torso_roll": 0.2}}},
    "damping": {"simulator.motors": MOTORS | {"friction": 0.0}},
    "lag": {"simulator.motors": MOTORS | {"time_constant": 0.005}},
    "elasticity": {
        "simulator.motors": MOTORS | {"time_constant": 0.005, "elasticity": {"stiffness": 500.0, "damping": 2.0}}
    },
    "drives at their stops": {"simulator.motors": MOTORS | {"inertia": 0.002}, "simulator.joint_stops": True},
    "late commands": {
        "simulator.motors": MOTORS,
        "simulator.actuation": {"torque_delay": 0.005, "thrust_delay": 0.02, "jitter": 0.01, "drop": 0.1, "seed": 4},
    },
    "pushes": {
        "disturbances.pushes": [
            {"body": "chest", "force": [30.0, -5.0, 2.0], "start": 0.0, "duration": 0.05},
            {"body": "l_elbow_1", "moment": [0.5, 1.0, -2.0], "start": 0.0837, "duration": 0.0461},
        ]
    },
    "joints that fail": {
        "simulator.motors": MOTORS,
        "disturbances.joints": [
            {"joint": "l_elbow", "kind": "stuck", "start": 0.06},
            {"joint": "r_knee", "kind": "weak", "start": 0.05},
            {"joint": "torso_roll", "kind": "free", "start": 0.0},
        ],
    },
    "slow jets": {"disturbances.jets.lag": 0.05},
    "a jet that is stuck": {"disturbances.jets.failure": FAILURE},
    "a jet that stops": {"disturbances.jets.failure": FAILURE | {"kind": "off"}},
    "a jet that fades": {"disturbances.jets.failure": FAILURE | {"kind": "off", "decay": 0.2}},
    "engines": {"simulator.jets": {"dynamics": "throttled"}, "disturbances.jets.lag": 0.05},
    "another robot than the model": {
        "disturbances.model_error": ERRORS | {"of_plant": True, "thrust_axes": [[0.02, 0.0, 0.01]] + 3 * [[0, 0, 0]]}
    },
}


@pytree
class Given:
    """Commands that are given, tick by tick."""

    torque: Array
    thrust_rate: Array

    def init(self, _robot, _state):
        return jnp.array(0)

    def step(self, _robot, tick, _measurement):
        return tick + 1, sim.Command(self.thrust_rate[tick], self.torque[tick])


@pytest.fixture(scope="module")
def given():
    """Torques that turn joints, stop them and turn them back, and thrust rates."""
    rng = np.random.default_rng(3)
    times = 0.01 * np.arange(TICKS + 1)[:, None]
    torque = rng.uniform(-1.0, 1.0, 23) * np.sin(rng.uniform(5.0, 40.0, 23) * times)
    return Given(torque, rng.uniform(-60.0, 60.0, 4) * np.cos(rng.uniform(2.0, 20.0, 4) * times))


def fly(config, given):
    """Return positions of joints and base, velocities and thrusts as the crate flies them, after every tick."""
    flight, rows = rust.Flight(config), []
    for torque, thrust_rate in zip(given.torque[:TICKS], given.thrust_rate, strict=False):
        flight.step(command=rust.Command(thrust_rate, torque))
        state, thrust = flight.truth[1:3]
        rows.append((state.joint_position, state.base_position, state.velocity, thrust))
    assert flight.tick == TICKS
    return [np.stack(column) for column in zip(*rows, strict=True)]


@pytest.fixture(scope="module")
def without(given):
    return fly(rust.load_config("no_wind", STILL), given)


@pytest.mark.parametrize("case", CASES)
def test_a_term_of_the_plant(case, given, without, agree):
    """The state after every tick, in which what a case adds is felt."""
    config = rust.load_config("no_wind", STILL | CASES[case])
    expected = fly(config, given)
    scenario, start = sim.prepare(config, controller=given)
    rows = jax.jit(lambda *flight: sim.rollout(*flight, TICKS + 1, sim.keep_row)[1])(scenario, start)
    velocity = jnp.concatenate([rows["base_velocity"], rows["joint_velocity"]], axis=1)
    found = rows["joint_position"], rows["base_position"], velocity, rows["thrust"]
    for name, ours, theirs in zip(("joints", "base", "velocity", "thrust"), found, expected, strict=True):
        # A rounding of 1e-16, multiplied by the condition of the mass matrix, 1e5, and carried on for 64 steps.
        agree(f"{case}: {name}", ours[1:], theirs, 1e-9)
    apart = max(np.abs(one - other).max() for one, other in zip(expected, without, strict=True))
    assert (apart > 1e-3) == (case != "nothing")
