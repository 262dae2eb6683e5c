"""Simulated sensors: pose and velocity of the base, joints, thrusts; and the wind ahead.

```text
truth ──► delay ──► + bias + drift + noise ──► measured state and thrusts
joints ──► delay ──► + bias + tremble ──► steps of the encoder ──► differences ──► low pass
```

Noise is drawn before the flight. All sizes, and whether encoders differentiate, are numbers; the length of the delay
line is structure. Steps of encoders count in derivatives as if there were none (straight-through): their own are zero.

Equations M88 to M90 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero import rust
from jax_aero.body.spatial import exp_so3, multiply
from jax_aero.config import SensorsConfig
from jax_aero.control.measurement import Measurement, Reading
from jax_aero.control.preview import Preview
from jax_aero.sim.wind import Wind, wind_velocity
from jax_aero.types import Array, State, join, leaf, pytree, static

STREAM = 2


@pytree
class Sensors:
    """Errors of the sensors in one flight."""

    bias: Float[Array, "4 3"]
    """Bias of base position, rotation, linear and angular velocity [m, rad, m/s, rad/s]."""
    drift: Float[Array, "4 3"]
    """Change of the biases per second."""
    noise_std: Float[Array, "4"]
    """Standard deviations of the noise of the same quantities."""
    age: Int[Array, "6"]
    """Ages of the same quantities, of joints and of thrusts [ticks]."""
    noise: Float[Array, "ticks drawn"]
    """Noise of unit standard deviation: four sensors with three axes, then jets."""
    joint_bias: Float[Array, " n"]
    """Bias of joint positions [rad, m]."""
    tremble: Float[Array, "2"]
    """Amplitude and angular frequency of an oscillation of all measured joint positions [rad, rad/s]."""
    resolution: Float[Array, ""]
    """Resolution of joint positions [rad, m]; zero for exact ones."""
    is_difference: Bool[Array, ""]
    """Whether joint velocities are computed by differences of positions."""
    share: Float[Array, ""]
    """Share of a change that the low pass of joint velocities follows per tick."""
    thrust_bias: Float[Array, ""]
    """Bias of thrusts [N]."""
    thrust_noise_std: Float[Array, ""]
    """Standard deviation of the noise of thrusts [N]."""
    thrust_resolution: Float[Array, ""]
    """Resolution of thrusts [N]; zero for exact ones."""
    wind_ahead: Float[Array, " _"] | None
    """Times ahead at which the controller receives the true wind, from zero on [s]; `None` without a preview."""
    time_step: Float[Array, ""]
    """Time step [s]."""
    line: int = static()
    """Length of the delay line: greatest age plus one [ticks]."""

    def start(self, first: Measurement) -> SensorState:
        """Return sensors whose delay lines are filled with the first state and thrusts."""
        reading = Reading(first.state, first.thrust)
        return SensorState(jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * self.line), reading), reading)

    def measure(
        self, state: SensorState, true: Measurement, tick: Int[Array, ""], wind: Wind
    ) -> tuple[SensorState, Measurement]:
        """Measure state and thrusts of a tick, and look at the wind ahead."""
        state, said = read(self, state, Reading(true.state, true.thrust), tick)
        measured = true._replace(state=said.state, thrust=said.thrust)
        if self.wind_ahead is not None:
            winds = jax.vmap(wind_velocity, in_axes=(None, 0))(wind, true.time + self.wind_ahead)
            ahead = jnp.concatenate([self.wind_ahead[:, None], winds], axis=1)
            measured = measured._replace(preview=Preview(wind=ahead))
        return state, measured


class SensorState(NamedTuple):
    """State of the sensors between two ticks."""

    line: Reading
    """True values of the last ticks, the latest first, along an additional first axis."""
    said: Reading
    """Output of the last tick."""


def sensors(config: SensorsConfig, time_step: Float[Array, ""], ticks: int, joints: int, jets: int) -> Sensors:
    """Return the sensors of a flight of `ticks` ticks. Call it outside loops, since it draws noise."""
    tremble = config.joints.tremble
    base = (config.base_position, config.base_rotation, config.base_linear_velocity, config.base_angular_velocity)
    delays = [*(sensor.delay for sensor in base), config.joints.delay, config.thrust.delay]
    age = np.floor(np.asarray(delays) / np.asarray(time_step) + 0.5).astype(np.int32)  # half a tick rounds up
    time_constant = config.joints.velocity_time_constant
    width, last = 12 + jets, int(np.floor(config.wind_preview / np.asarray(time_step) + 0.5))
    return Sensors(
        bias=leaf([sensor.bias for sensor in base]),
        drift=leaf([sensor.drift for sensor in base]),
        noise_std=leaf([sensor.noise_std for sensor in base]),
        age=jnp.asarray(age),
        noise=jnp.asarray(rust.normals(config.seed, STREAM, width * (ticks + 1)).reshape(-1, width)),
        joint_bias=leaf(np.asarray(config.joints.bias or np.zeros(joints))),
        tremble=leaf([0.0, 0.0] if tremble is None else [tremble.amplitude, 2.0 * np.pi * tremble.frequency]),
        resolution=leaf(config.joints.resolution),
        is_difference=jnp.asarray(time_constant is not None),
        share=leaf(-np.expm1(-np.asarray(time_step) / time_constant) if time_constant else 1.0),
        thrust_bias=leaf(config.thrust.bias),
        thrust_noise_std=leaf(config.thrust.noise_std),
        thrust_resolution=leaf(config.thrust.resolution),
        wind_ahead=leaf(np.arange(last + 1) * np.asarray(time_step)) if last else None,
        time_step=time_step,
        line=int(np.max(age)) + 1,
    )


def read(errors: Sensors, before: SensorState, truth: Reading, tick: Int[Array, ""]) -> tuple[SensorState, Reading]:
    """Return the sensors' next state and their output for the true values of this tick."""
    line = jax.tree.map(lambda old, new: jnp.concatenate([new[None], old[:-1]]), before.line, truth)

    def past_state(sensor: int) -> State:
        past: State = jax.tree.map(lambda x: x[errors.age[sensor]], line.state)
        return past

    drawn = errors.noise[jnp.minimum(tick, errors.noise.shape[0] - 1)]
    time = tick.astype(errors.noise.dtype) * errors.time_step
    position, rotation, linear, angular = (
        errors.bias + time * errors.drift + errors.noise_std[:, None] * drawn[:12].reshape(4, 3)
    )
    base_rotation = multiply(past_state(1).base_rotation, exp_so3(rotation))
    turning = past_state(3)
    gyro = turning.base_rotation.T @ turning.velocity[3:6] + angular

    joints, last = past_state(4), before.said.state
    joint_position = _encode(errors, joints.joint_position, time)
    was = last.velocity[6:]
    moved = was + errors.share * ((joint_position - last.joint_position) / errors.time_step - was)
    joint_velocity = jnp.where(errors.is_difference & (tick > 0), moved, joints.velocity[6:])

    said = Reading(
        State(
            base_position=past_state(0).base_position + position,
            base_rotation=base_rotation,
            joint_position=joint_position,
            velocity=join(past_state(2).velocity[:3] + linear, base_rotation @ gyro, joint_velocity),
        ),
        _quantise(
            line.thrust[errors.age[5]] + errors.thrust_bias + errors.thrust_noise_std * drawn[12:],
            errors.thrust_resolution,
        ),
    )
    return SensorState(line, said), said


def _encode(errors: Sensors, position: Array, time: Array) -> Array:
    """Return joint positions as they are measured at `time` (M90)."""
    # The phase of each joint is a radian behind that of the one before.
    amplitude, rate = errors.tremble
    phase = rate * time - jnp.arange(errors.joint_bias.shape[0], dtype=errors.joint_bias.dtype)
    return _quantise(position + (errors.joint_bias + amplitude * jnp.sin(phase)), errors.resolution)


def _quantise(measured: Array, resolution: Array) -> Array:
    """Return the nearest multiples of a resolution; zero leaves a measurement as it is."""
    # Multiplied by the reciprocal explicitly, as XLA does: ties must round equally in both languages.
    steps = measured * (1.0 / jnp.where(resolution > 0.0, resolution, 1.0))
    return jnp.where(resolution > 0.0, resolution * _round(steps), measured)


@jax.custom_jvp
def _round(steps: Array) -> Array:
    """Return the nearest whole numbers, halves away from zero; with the derivative of the identity."""
    return jnp.sign(steps) * jnp.floor(jnp.abs(steps) + 0.5)


@_round.defjvp
def _round_jvp(primals, tangents):  # type: ignore[no-untyped-def]
    return _round(*primals), tangents[0]
