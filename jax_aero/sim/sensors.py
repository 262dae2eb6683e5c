"""Simulated sensors of the robot's state: pose and velocity of the base, joints, thrusts.

```text
truth ──► delay ──► + bias + noise ──► measured state and thrusts
joints ──► delay ──► steps of the encoder ──► differences ──► low pass
```

Noise is drawn before the flight. Whether encoders differentiate, and all sizes, are numbers; the length of the delay
line is structure.

Equations M88 to M90 of `docs/model.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero import noise
from jax_aero.config import SensorsConfig
from jax_aero.control.estimator import Reading
from jax_aero.spatial import exp_so3, multiply
from jax_aero.types import Array, State, Static, joined, leaf, pytree

STREAM = 2


@pytree
class Sensors:
    """Errors of the sensors of one flight."""

    bias: Float[Array, "4 3"]
    """Of base position, rotation, linear and angular velocity [m, rad, m/s, rad/s]."""
    noise_std: Float[Array, "4"]
    """Of the same."""
    age: Int[Array, "6"]
    """In ticks, of the same, of joints and thrusts."""
    noise: Float[Array, "ticks drawn"]
    """Of standard deviation one: four sensors of three axes, then jets."""
    resolution: Float[Array, ""]
    """Step of joint positions [rad, m]; zero for none."""
    is_difference: Bool[Array, ""]
    """Whether joint velocities are differences of positions."""
    share: Float[Array, ""]
    """Share of the way that their low pass goes per tick."""
    thrust_bias: Float[Array, ""]
    """[N]."""
    thrust_noise_std: Float[Array, ""]
    """[N]."""
    time_step: Float[Array, ""]
    """[s]."""
    line: Static[int]
    """Ticks in the delay line: the present one, and as many as the greatest age."""


class SensorState(NamedTuple):
    """Sensors from one tick to the next."""

    line: Reading
    """The last ticks, the latest first: one more axis in front."""
    said: Reading
    """Of the last tick."""


def sensors(config: SensorsConfig, time_step: Float[Array, ""], ticks: int, jets: int) -> Sensors:
    """Sensors of a flight of so many ticks. Outside loops: noise is drawn here."""
    base = (config.base_position, config.base_rotation, config.base_linear_velocity, config.base_angular_velocity)
    delays = [*(sensor.delay for sensor in base), config.joints.delay, config.thrust.delay]
    age = np.floor(np.asarray(delays) / np.asarray(time_step) + 0.5).astype(np.int32)  # half a tick rounds up
    time_constant = config.joints.velocity_time_constant
    width = 12 + jets
    return Sensors(
        bias=leaf([sensor.bias for sensor in base]),
        noise_std=leaf([sensor.noise_std for sensor in base]),
        age=jnp.asarray(age),
        noise=jnp.asarray(noise.normals(config.seed, STREAM, width * (ticks + 1)).reshape(-1, width)),
        resolution=leaf(config.joints.resolution),
        is_difference=jnp.asarray(time_constant is not None),
        share=leaf(-np.expm1(-np.asarray(time_step) / time_constant) if time_constant else 1.0),
        thrust_bias=leaf(config.thrust.bias),
        thrust_noise_std=leaf(config.thrust.noise_std),
        time_step=time_step,
        line=int(np.max(age)) + 1,
    )


def start(errors: Sensors, first: Reading) -> SensorState:
    """Sensors that have seen this reading for as long as they look back."""
    return SensorState(jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * errors.line), first), first)


def read(errors: Sensors, before: SensorState, truth: Reading, tick: Int[Array, ""]) -> tuple[SensorState, Reading]:
    """Read all sensors; the state of the next tick, and what they say."""
    line = jax.tree.map(lambda old, new: jnp.concatenate([new[None], old[:-1]]), before.line, truth)

    def then(sensor: int) -> State:
        past: State = jax.tree.map(lambda x: x[errors.age[sensor]], line.state)
        return past

    drawn = errors.noise[jnp.minimum(tick, errors.noise.shape[0] - 1)]
    position, rotation, linear, angular = errors.bias + errors.noise_std[:, None] * drawn[:12].reshape(4, 3)
    base_rotation = multiply(then(1).base_rotation, exp_so3(rotation))
    turning = then(3)
    gyro = turning.base_rotation.T @ turning.velocity[3:6] + angular

    joints, last = then(4), before.said.state
    # Not divided by the resolution: XLA makes a multiplication of that, and ties must round alike in both languages.
    steps = joints.joint_position * (1.0 / jnp.where(errors.resolution > 0.0, errors.resolution, 1.0))
    rounded = errors.resolution * jnp.sign(steps) * jnp.floor(jnp.abs(steps) + 0.5)  # halves away from zero
    joint_position = jnp.where(errors.resolution > 0.0, rounded, joints.joint_position)
    was = last.velocity[6:]
    moved = was + errors.share * ((joint_position - last.joint_position) / errors.time_step - was)
    joint_velocity = jnp.where(errors.is_difference & (tick > 0), moved, joints.velocity[6:])

    said = Reading(
        State(
            base_position=then(0).base_position + position,
            base_rotation=base_rotation,
            joint_position=joint_position,
            velocity=joined(then(2).velocity[:3] + linear, base_rotation @ gyro, joint_velocity),
        ),
        line.thrust[errors.age[5]] + errors.thrust_bias + errors.thrust_noise_std * drawn[12:],
    )
    return SensorState(line, said), said
