"""Comparison of ticks unlike any flight: every intermediate value of the controller, and its command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.types import Setpoint, State
from jax_aero.verify import (
    KERNEL_TOLERANCE,
    OF_SOLVERS,
    QP_TOLERANCE,
    SOLUTIONS,
    Row,
    Sample,
    compare,
    round_sample,
)
from jax_aero.verify.law import law_of
from jax_aero.verify.lines import Sides, count_sides

OVERFLOW = 1e100
"""Number beyond which a result has overflowed."""


def verify_ticks(config: Mapping[str, Any], samples: Sequence[Sample], sides: list[Sides] | None = None) -> list[Row]:
    """Compare every intermediate value of the controller, and its command, in two ticks from each of given samples.

    The second tick is that of the next sample, with the first one's memory: torques of the last tick, plans and
    observers. The sides that choices have taken are appended to `sides`.
    """
    return compare_ticks(config, samples, twin_ticks(*law_of(config), samples, sides))


def verify_held(config: Mapping[str, Any], samples: Sequence[Sample], sides: list[Sides] | None = None) -> list[Row]:
    """Compare the commands where a QP has no answer, as a number of its overflows: what is held, and not integrated."""
    spoilt = [spoil(place, sample) for place, sample in enumerate(samples)]
    return compare_held(config, spoilt, twin_ticks(*law_of(config), spoilt, sides))


def compare_held(config: Mapping[str, Any], spoilt: Sequence[Sample], ours: Mapping[str, Any]) -> list[Row]:
    """Compare the commands of spoilt samples."""
    names = ("thrust_rate", "joint_velocity_command", "joint_torque", "velocity_error_integral")
    return compare_ticks(config, spoilt, {name: ours[name] for name in names if name in ours}, "held", OF_SOLVERS)


def spoil(place: int, sample: Sample) -> Sample:
    """Return every other sample with an overflow in the momentum QP, in that of the torques, or in both."""
    posture, inertia, integral = sample.memory
    kind = place // 2 % 3 if place % 2 else None
    heavy = 1e307 * np.eye(3) if kind in (0, 2) else inertia
    wound = np.full_like(integral, 1e307) if kind in (1, 2) else integral
    return replace(sample, memory=(posture, heavy, wound))


def compare_ticks(
    config: Mapping[str, Any],
    samples: Sequence[Sample],
    ours: Mapping[str, Any],
    group: str = "random",
    modes: Sequence[str] = (),
) -> list[Row]:
    """Compare the quantities that JAX's `twin_ticks` has with the crate's, where it has no modes but these."""
    rng = np.random.default_rng(0)
    theirs = crate_ticks(config, samples)
    near = crate_ticks(config, [round_sample(rng, sample) for sample in samples])
    # Where fault detection acts on the jump between two samples, JAX has nothing to compare.
    alike = [{*one.degraded_modes, *other.degraded_modes} <= {*modes} for one, other in zip(theirs, near, strict=True)]

    def compare_all(name: str) -> Row:
        tolerance = QP_TOLERANCE if name in SOLUTIONS else KERNEL_TOLERANCE
        of_crate = ([crate_quantity(tick, name) for tick in compress(ticks, alike)] for ticks in (theirs, near))
        # What has overflowed is equal where it has in both.
        twin, expected, rounded = (
            np.where(np.abs(part) > OVERFLOW, np.nan, part) for part in (ours[name][np.array(alike)], *of_crate)
        )
        return compare(group, name, twin, expected, tolerance, rounded=rounded)

    return [compare_all(name) for name in ours]


def twin_ticks(
    params: MomentumController, robot: RobotModel, samples: Sequence[Sample], sides: list[Sides] | None = None
) -> dict[str, Any]:
    """Return the quantities of both ticks of every sample, the first ticks of all before the second ones."""
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *((*sample.memory, *_given(sample)) for sample in samples))
    quantities, taken = jax.device_get(_twin_ticks(params, robot, batch))
    if sides is not None:
        sides.append(taken)
    return {name: np.concatenate(np.moveaxis(value, 1, 0)) for name, value in quantities.items()}


def _given(sample: Sample) -> tuple[State, Any, Any, Setpoint]:
    followed = Setpoint(*(getattr(sample.setpoint, name) for name in Setpoint._fields))
    return State(*map(jnp.asarray, sample.state)), sample.thrust, sample.wind, followed


@partial(jax.jit, compiler_options=COMPILER_OPTIONS)
@count_sides
def _twin_ticks(params: MomentumController, robot: RobotModel, batch: Any) -> dict[str, Any]:
    following = jax.tree.map(lambda leaf: jnp.roll(leaf, -1, axis=0), batch)
    times = jnp.stack([jnp.zeros_like(params.time_step), params.time_step])

    def two_ticks(samples: Any) -> dict[str, Any]:
        memory = control.init(params, robot, samples[0][3])

        def one_tick(memory: ControllerState, now: Any) -> tuple[ControllerState, dict[str, Any]]:
            time, (posture, inertia, integral, state, thrust, wind, followed) = now
            memory = memory._replace(posture=posture, inertia_0=inertia, velocity_error_integral=integral)
            memory, command, terms = control.tick(params, robot, memory, time, state, thrust, wind, followed)
            quantities = tick_quantities(command, terms) | {"velocity_error_integral": memory.velocity_error_integral}
            # With an empty result, of a robot without joints, jaxlib 0.10 does not compile calls of LAPACK.
            return memory, {name: value for name, value in quantities.items() if value.size}

        both = jax.tree.map(lambda *leaves: jnp.stack(leaves), *samples)
        quantities: dict[str, Any] = jax.lax.scan(one_tick, memory, (times, both))[1]
        return quantities

    both_ticks: dict[str, Any] = jax.lax.map(two_ticks, (tuple(batch), tuple(following)))
    return both_ticks


def crate_ticks(config: Mapping[str, Any], samples: Sequence[Sample]) -> list[rust.Tick]:
    """Return the crate's ticks of every sample, as `twin_ticks` returns JAX's."""
    controller, first, second = rust.Controller(config), [], []
    for sample, following in zip(samples, [*samples[1:], samples[0]], strict=True):
        started = controller.start(sample.state, sample.thrust, sample.wind)
        controller.state = started.with_posture_control(*(np.ascontiguousarray(part) for part in sample.memory))
        first.append(controller.tick(sample.state, sample.thrust, sample.wind, 0.0, sample.setpoint))
        remembered = controller.state or started
        controller.state = remembered.with_posture_control(*(np.ascontiguousarray(part) for part in following.memory))
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
