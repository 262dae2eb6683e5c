"""Gradient of a flight's position error by the controller's gains, in JAX (half a minute of compilation)."""

import jax
import jax.numpy as jnp

import jax_aero

jax.config.update("jax_enable_x64", True)
scenario, start = jax_aero.prepare(jax_aero.load("test1", {"wind.ramp_start": -1.0, "wind.ramp_end": 0.5}))


def error(gain):
    """Sum of squares over half a second [m²]."""
    flight = jax_aero.replace_values(scenario, {"controller.momentum.kp_linear": gain})
    moved = jax_aero.rollout(flight, start, 50, lambda row: row["com_position"] - row["com_setpoint"])[1]
    return jnp.sum(moved**2)


gain = jnp.asarray(jax_aero.load("test1")["controller"]["momentum"]["kp_linear"])
value, slope = jax.value_and_grad(error)(gain)
print(f"error {value:.2e} m², its derivative by the gain {slope}")
