"""Comparison of ticks unlike any flight: every intermediate value of the controller, and its command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import compress
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero import rust
from jax_aero.body.robot import RobotModel
from jax_aero.control import tick as control
from jax_aero.control.state import ControllerState
from jax_aero.control.tick import MomentumController
from jax_aero.types import Setpoint, State
from jax_aero.verify import (
    KERNEL_TOLERANCE,
    QP_TOLERANCE,
    SOLUTIONS,
    UNOPTIMISED,
    Row,
    Sample,
    compare,
    round_sample,
)
from jax_aero.verify.law import law_of


def verify_ticks(config: Mapping[str, Any], samples: Sequence[Sample]) -> list[Row]:
    """Compare every intermediate value of the controller, and its command, in two ticks from each of given samples.

    The second tick has the measurement of the next sample, and the memory of the first: torques of the last tick,
    integrals, plans and observers.
    """
    return compare_ticks(config, samples, twin_ticks(*law_of(config), samples))


def compare_ticks(config: Mapping[str, Any], samples: Sequence[Sample], ours: Mapping[str, Any]) -> list[Row]:
    """Compare the quantities that JAX's `twin_ticks` has with the crate's."""
    rng = np.random.default_rng(0)
    theirs = crate_ticks(config, samples)
    near = crate_ticks(config, [round_sample(rng, sample) for sample in samples])
    # Where fault detection acts on the jump between two samples, JAX has nothing to compare.
    alike = [not (one.degraded_modes or other.degraded_modes) for one, other in zip(theirs, near, strict=True)]

    def compare_all(name: str) -> Row:
        tolerance = QP_TOLERANCE if name in SOLUTIONS else KERNEL_TOLERANCE
        expected, rounded = (
            [crate_quantity(tick, name) for tick in compress(ticks, alike)] for ticks in (theirs, near)
        )
        return compare("random", name, ours[name][np.array(alike)], expected, tolerance, rounded=rounded)

    return [compare_all(name) for name in ours]


def twin_ticks(params: MomentumController, robot: RobotModel, samples: Sequence[Sample]) -> dict[str, Any]:
    """Return the quantities of both ticks of every sample, the first ticks of all before the second ones."""
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *((*sample.memory, *_given(sample)) for sample in samples))
    found: dict[str, Any] = jax.device_get(_twin_ticks(params, robot, batch))
    return {name: np.concatenate(np.moveaxis(value, 1, 0)) for name, value in found.items()}


def _given(sample: Sample) -> tuple[State, Any, Any, Setpoint]:
    followed = Setpoint(*(getattr(sample.setpoint, name) for name in Setpoint._fields))
    return State(*map(jnp.asarray, sample.state)), sample.thrust, sample.wind, followed


@partial(jax.jit, compiler_options=UNOPTIMISED)
def _twin_ticks(params: MomentumController, robot: RobotModel, batch: Any) -> dict[str, Any]:
    posture, inertia, integral, *given = batch
    following = jax.tree.map(lambda leaf: jnp.roll(leaf, -1, axis=0), given)
    times = jnp.stack([jnp.zeros_like(params.time_step), params.time_step])

    def two_ticks(sample: Any) -> dict[str, Any]:
        memory = control.init(params, robot, sample[3])
        memory = memory._replace(posture=sample[0], inertia_0=sample[1], velocity_error_integral=sample[2])

        def one_tick(memory: ControllerState, now: Any) -> tuple[ControllerState, dict[str, Any]]:
            time, (state, thrust, wind, followed) = now
            memory, command, terms = control.tick(params, robot, memory, time, state, thrust, wind, followed)
            integral = {"velocity_error_integral": memory.velocity_error_integral}
            return memory, tick_quantities(command, terms) | integral

        both = jax.tree.map(lambda *leaves: jnp.stack(leaves), sample[3:7], sample[7:])
        found: dict[str, Any] = jax.lax.scan(one_tick, memory, (times, both))[1]
        return found

    both_ticks: dict[str, Any] = jax.lax.map(two_ticks, (posture, inertia, integral, *given, *following))
    return both_ticks


def crate_ticks(config: Mapping[str, Any], samples: Sequence[Sample]) -> list[rust.Tick]:
    """Return the crate's ticks of every sample, as `twin_ticks` returns JAX's."""
    controller, first, second = rust.Controller(config), [], []
    for sample, following in zip(samples, [*samples[1:], samples[0]], strict=True):
        started = controller.start(sample.state, sample.thrust, sample.wind)
        controller.state = started.with_posture_control(*(np.ascontiguousarray(part) for part in sample.memory))
        first.append(controller.tick(sample.state, sample.thrust, sample.wind, 0.0, sample.setpoint))
        time = config["controller"]["time_step"]
        second.append(controller.tick(following.state, following.thrust, following.wind, time, following.setpoint))
    return first + second


def tick_quantities(command: Any, terms: Any) -> dict[str, Any]:
    """Return every value of a tick by its name in `rust.Tick`."""
    link, momentum, attitude = terms.link_forces, terms.momentum, terms.attitude
    shaping, following = terms.momentum_qp, terms.torque_qp
    return {
        "com_position": terms.kinematics.com,
        **terms.dynamics._asdict(),
        "link_axes": link.axes,
        "link_v_air": link.v_air,
        "link_arm_points": link.arm_points,
        "link_jacobian_points": link.jacobian_points,
        "aero_force": link.forces,
        "jet_axes": momentum.jet_axes,
        "jet_points": momentum.jet_points,
        "a_t": momentum.a_t,
        "lambda_t": momentum.lambda_t,
        "lambda_a": momentum.lambda_a,
        "momentum_rate_estimate": momentum.rate_estimate,
        "unmodelled_wrench": momentum.unmodelled_wrench,
        "k_ddot_desired": attitude.k_ddot_desired,
        "sigma": attitude.sigma,
        "task": shaping.task,
        "task_offset": shaping.offset,
        **{f"momentum_qp.{name}": value for name, value in shaping.problem._asdict().items()},
        "thrust_rate": command.thrust_rate,
        "joint_velocity_command": command.joint_velocity,
        "joint_acceleration_desired": following.acceleration_desired,
        "joint_acceleration_free": following.acceleration_free,
        "torque_gain": following.gain,
        **{f"torque_qp.{name}": value for name, value in following.problem._asdict().items()},
        "unlimited_torque": terms.unlimited_torque,
        "joint_torque": command.joint_torque,
    }


def crate_quantity(tick: rust.Tick, name: str) -> Any:
    """Return a quantity of the crate's tick by a name of `tick_quantities`."""
    value: Any = tick
    for part in name.split("."):
        value = getattr(value, part)
    return value
