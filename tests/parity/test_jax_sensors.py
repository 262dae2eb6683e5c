"""Sensors in JAX against the crate's: the same truth, read by both."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from jax_aero import rust
from jax_aero.base.typed_config import scenario_config
from jax_aero.control.measurement import Reading
from jax_aero.sim.sensors import read, sensors
from jax_aero.verify.flight import states_of

EXPERIMENT = "test2_observer"
SENSORS = {
    "seed": 3,
    "base_position": {"bias": [0.01, 0.0, 0.02], "noise_std": 0.003, "delay": 0.02},
    "base_rotation": {"bias": [0.003, 0.002, 0.0], "noise_std": 0.002, "delay": 0.01},
    "base_linear_velocity": {"bias": [0.0, 0.01, 0.0], "drift": [0.02, 0.0, -0.03], "noise_std": 0.004, "delay": 0.034},
    "base_angular_velocity": {"bias": [0.001, -0.002, 0.001], "noise_std": 0.002},
    "joints": {
        "bias": [0.001 * joint for joint in range(23)],
        "tremble": {"amplitude": 0.002, "frequency": 7.0},
        "resolution": 5e-4,
        "velocity_time_constant": 0.02,
        "delay": 0.01,
    },
    "thrust": {"bias": 0.2, "noise_std": 0.1, "resolution": 0.25, "delay": 0.02},
}


def test_both_read_the_same(x64, agree_with_the_log):
    """The truth is that of a flight of the crate, whose log has what its sensors measured.

    It begins with every joint in the middle between two steps of its encoder.
    """
    table = rust.load_config(EXPERIMENT, {"simulator.duration": 0.6, "simulator.sensors": SENSORS})
    first, step = table["simulator"]["initial"], SENSORS["joints"]["resolution"]
    first["joint_position"] = [round((math.floor(s / step) + 0.5) * step, 6) for s in first["joint_position"]]
    flown = rust.fly(table)
    config = scenario_config(table)
    truth = Reading(states_of(flown.log), jnp.asarray(flown["thrust"]))
    ticks = len(flown["time"])
    errors = sensors(config.simulator.sensors, jnp.asarray(config.controller.time_step), ticks - 1, 23, 4)
    before = errors.start(jax.tree.map(lambda x: x[0], truth))

    def tick(state, now):
        return read(errors, state, *now)

    _, said = jax.lax.scan(tick, before, (truth, jnp.arange(ticks)))
    because = "one rotation from a quaternion, and a difference of positions over 10 ms"
    agree_with_the_log(said, flown, 1e-12, because)
