"""Comparison of ticks unlike any flight: every intermediate value of the controller, and its command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jax_aero import rust
from jax_aero.control import tick as control
from jax_aero.types import Setpoint, State
from jax_aero.verify import KERNEL_TOLERANCE, QP_TOLERANCE, SOLUTIONS, Row, Sample, compare, round_sample
from jax_aero.verify.law import law_of


def verify_ticks(config: Mapping[str, Any], samples: Sequence[Sample]) -> list[Row]:
    """Compare every intermediate value of the controller, and its command, on given samples."""
    params, robot = law_of(config)

    @jax.jit
    def evaluate(memory: Any, state: State, thrust: Any, wind: Any, followed: Setpoint) -> Any:
        memory = control.init(params, robot, state)._replace(**memory)
        _, command, terms = control.tick(params, robot, memory, jnp.zeros(()), state, thrust, wind, followed)
        return command, terms

    rng, ours = np.random.default_rng(0), []
    for sample in samples:
        memory = dict(zip(("posture", "inertia_0", "velocity_error_integral"), sample.memory, strict=True))
        followed = Setpoint(*(jnp.asarray(getattr(sample.setpoint, name)) for name in Setpoint._fields))
        state = State(*(jnp.asarray(value) for value in sample.state))
        found = jax.device_get(evaluate(memory, state, sample.thrust, sample.wind, followed))
        ours.append(tick_quantities(*found))
    theirs = [_crate_tick(config, sample) for sample in samples]
    near = [_crate_tick(config, round_sample(rng, sample)) for sample in samples]

    def compare_all(name: str) -> Row:
        tolerance = QP_TOLERANCE if name in SOLUTIONS else KERNEL_TOLERANCE
        expected, rounded = ([crate_quantity(tick, name) for tick in ticks] for ticks in (theirs, near))
        return compare("random", name, [tick[name] for tick in ours], expected, tolerance, rounded=rounded)

    return [compare_all(name) for name in ours[0]]


def _crate_tick(config: Mapping[str, Any], sample: Sample) -> rust.Tick:
    controller = rust.Controller(config)
    started = controller.start(sample.state, sample.thrust, sample.wind)
    controller.state = started.with_posture_control(*(np.ascontiguousarray(part) for part in sample.memory))
    return controller.tick(sample.state, sample.thrust, sample.wind, 0.0, sample.setpoint)


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
