"""What the controller is given in JAX and by the crate: errors of the measured wind, outages, sensors."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.types import pytree

pytestmark = pytest.mark.usefixtures("x64")

RISING = {"profile": "ramp", "velocity": [2.0, -7.0, 0.5], "ramp_start": 0.0, "ramp_end": 0.2}
OTHER = {"profile": "gust", "velocity": [0.0, -4.0, 0.0], "gust": [2.0, 0.0, -1.0], "start": 0.05, "duration": 0.2}
CHANNELS = {"wind": 0.4, "joints": 0.01, "base_position": 0.02, "base_rotation": 0.03, "base_velocity": 0.05}
CASES = {
    "bias": {"wind_estimate": {"bias": [0.5, -0.3, 0.1]}},
    "noise": {"wind_estimate": {"noise_std": 0.7, "seed": 9}},
    "delay": {"wind_estimate": {"delay": 0.05}},
    "low pass": {"wind_estimate": {"time_constant": 0.08, "bias": [0.5, 0.0, 0.0], "noise_std": 0.2, "delay": 0.02}},
    "mean": {"wind_estimate": {"mean_only": True, "time_constant": 0.08}},
    "another wind": {"controller_wind": OTHER},
    "mean of another wind": {"controller_wind": OTHER, "wind_estimate": {"mean_only": True}},
    **{
        f"wrong {channel}": {
            "outages": [{"channel": channel, "kind": "wrong", "error": error, "start": 0.1, "duration": 0.1}]
        }
        for channel, error in CHANNELS.items()
    },
    "wrong thrust": {
        "outages": [
            {"channel": "thrust", "kind": "wrong", "error": 3.0, "start": 0.1, "jet": "r_arm_jet"},
            {"channel": "thrust", "kind": "wrong", "error": -2.0, "start": 0.15},
        ]
    },
}


@pytree
class Still:
    """Does nothing."""

    def init(self, _robot, _state):
        return ()

    def step(self, _robot, state, measurement):
        return state, sim.Command(jnp.zeros_like(measurement.thrust), jnp.zeros_like(measurement.state.velocity[6:]))


@pytest.mark.parametrize("case", CASES)
def test_a_measurement(case, agree):
    """Every tick of 0.25 s of a robot that falls through a rising wind, by the sensors of a robot."""
    config = rust.load_config("test2_sensors", {"simulator.duration": 0.25}) | {"wind": RISING}
    config = config | {"disturbances": CASES[case]}
    rust.check_config(config)
    flight, rows = rust.Flight(config), []
    for _ in range(25):
        given = flight.measurement
        rows.append((given.wind, given.thrust, *given.state))
        flight.step(command=rust.Command(np.zeros(4), np.zeros(23)))
    scenario, start = sim.prepare(config, controller=Still())
    ours = jax.jit(lambda *flight: sim.rollout(*flight, 25, sim.keep_row)[1])(scenario, start)
    velocity = jnp.concatenate([ours["raw_base_velocity"], ours["raw_joint_velocity"]], axis=1)
    names = ("wind", "thrust", "base_position", "base_rotation", "joint_position")
    found = {name: ours[f"raw_{name}"] for name in names} | {"velocity": velocity}
    for (name, value), theirs in zip(found.items(), zip(*rows, strict=True), strict=True):
        # Differences of positions over a tick, of joints without friction that run away.
        agree(f"{case}: {name}", value, np.stack(theirs), 1e-9)
