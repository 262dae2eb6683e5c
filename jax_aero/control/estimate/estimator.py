"""State estimator of the controller: a model corrected by delayed measurements and integrated to the present.

```text
measurements of ages d ──► delayed to a common age D ──► correct x̂(t − D)
x̂(t − D) ──► D ticks of the model under the past commands ──► x̂(t), for the controller
                  each corrected by what has been measured of it so far
```

Ages and shares are numbers; only the greatest age is structure, fixed at compilation.

Equations M91 to M93, M145 and M150 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jax_aero.aero import AeroModel, LinkConventions, generalised_aero_force, link_forces
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.jets import Engines, predict_thrust
from jax_aero.body.kinematics import generalised_thrust, kinematics, move
from jax_aero.body.linalg import solve_positive_definite
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import cross, exp_so3, log_so3, multiply, project_to_so3
from jax_aero.config import EstimatorConfig, LatencyConfig
from jax_aero.control.measurement import Reading
from jax_aero.types import Array, State, join, leaf, pytree, static, where

GREATEST = {"base": 1e6, "speed": 300.0, "angular velocity": 100.0, "joints": 100.0, "thrust": 10.0}
"""Greatest numbers of an estimate that the controller uses, as in the crate (M102).

Position of the base [m], its speed [m/s] and angular velocity [rad/s] along an axis, positions and velocities of joints
[rad, rad/s], ratio of a thrust to the jet's greatest.
"""


class Order(NamedTuple):
    """Inputs of the robot from one tick to the next."""

    torque: Float[Array, " n"]
    """Joint torques, less the friction of the drives [N m]."""
    thrust_rate: Float[Array, " j"]
    """Thrust rates [N/s]."""
    unmodelled: Float[Array, "6"]
    """Observed wrench that is in no model, about the centre of mass [N, N m]."""
    wind: Float[Array, "3"]
    """Wind that the controller uses [m/s]."""


@pytree
class Estimator:
    """Ages of the measurements and shares of their corrections.

    Order of the entries: base position, rotation, linear and angular velocity, joint positions, joint velocities,
    thrusts.
    """

    age: Int[Array, "7"]
    """Ages when the command of the tick begins to act [ticks]."""
    share: Float[Array, "7"]
    """Shares of the innovations by which the estimate is corrected."""
    by_position: Float[Array, "2"]
    """Shares of the joint positions' innovation that correct velocities, per tick, and accelerations, per tick²."""
    of_bias: Float[Array, ""]
    """Share of the rate with which the rotation is corrected that the bias of the gyroscopes receives."""
    time_step: Float[Array, ""]
    """Time step of the controller [s]."""
    greatest_age: int = static()
    """Greatest age [ticks]."""
    latency: int = static()
    """Whole ticks until torques act, which are part of the ages."""
    lags: tuple[float, float] = static()
    """What is left of the latencies of torques, below one, and thrust rates [ticks]."""


class EstimatorModel(NamedTuple):
    """The model of the robot."""

    robot: RobotModel
    aero: AeroModel
    engines: Engines | None
    """Engines that follow the thrust rates; `None` if thrusts do so themselves."""


class Estimate(NamedTuple):
    """State of the robot with what its model and its measurements do not contain."""

    reading: Reading
    thrust_rate: Float[Array, " j"] | None
    """Rates of the thrusts [N/s]; `None` without engines."""
    disturbance: Float[Array, " n"]
    """Joint accelerations that the model does not explain [rad/s²]."""
    gyro_bias: Float[Array, "3"]
    """Bias of the gyroscopes [rad/s, base axes]."""


class EstimatorState(NamedTuple):
    """State of the estimator between two ticks."""

    line: Reading
    """Last measurements, the latest first, greatest age + 1 of them along an additional first axis."""
    orders: Order
    """Last commands, in the same order, back to the thrust rates under the oldest measurement."""
    then: Estimate
    """Estimate at the greatest age."""
    ticks: Int[Array, ""]
    """Number of measurements processed."""


def estimator(config: EstimatorConfig, time_step: Float[Array, ""]) -> Estimator:
    """Return the estimator of a configuration."""
    channels = (
        config.base_position,
        config.base_rotation,
        config.base_linear_velocity,
        config.base_angular_velocity,
        config.joint_position,
        config.joint_velocity,
        config.thrust,
    )
    step = float(time_step)

    def share_of(time_constant: float) -> float:
        return -np.expm1(-step / time_constant) if time_constant > 0.0 else 1.0

    latency, lags = latency_in_ticks(config.latency, step)
    age = [latency + int(np.floor(channel.delay / step + 0.5)) for channel in channels]
    share = [share_of(channel.time_constant) for channel in channels]
    by_position = [0.0, 0.0]
    if config.joint_observer is not None:
        # Triple pole at e^(-Δt/T).
        left = share_of(config.joint_observer)
        pole = 1.0 - left
        age[5], share[4], share[5] = latency, 1.0 - pole**3, 0.0
        by_position = [left * left * (1.0 + 2.0 * pole), left**3]
    return Estimator(
        age=jnp.asarray(age, jnp.int32),
        share=leaf(share),
        by_position=leaf(by_position),
        of_bias=leaf(0.0 if config.gyro_bias is None else share_of(config.gyro_bias)),
        time_step=time_step,
        greatest_age=max(age),
        latency=latency,
        lags=lags,
    )


def latency_in_ticks(latency: LatencyConfig, time_step: float) -> tuple[int, tuple[float, float]]:
    """Return whole ticks until torques act, and what is left until torques and thrust rates act [ticks]."""
    # Decimal fractions are not exact.
    torque, thrust = (np.floor(time / time_step * 1e6 + 0.5) / 1e6 for time in (latency.torque, latency.thrust))
    whole = np.floor(torque)
    return int(whole), (float(torque - whole), float(thrust - whole))


def start(settings: Estimator, state: State, jets: int, *, has_engines: bool) -> EstimatorState:
    """Return the state before the first measurement, which replaces the given state and the thrusts of zero."""
    length = settings.greatest_age + 1

    rest = jnp.zeros_like(state.velocity)
    nothing = Reading(jax.tree.map(jnp.asarray, state), jnp.zeros(jets, rest.dtype))
    order = Order(rest[6:], nothing.thrust, rest[:6], rest[:3])
    line = jax.tree.map(lambda x: jnp.stack([x] * length), nothing)
    orders = jax.tree.map(lambda x: jnp.stack([x] * (length + int(np.ceil(settings.lags[1])))), order)
    then = Estimate(nothing, nothing.thrust if has_engines else None, rest[6:], rest[:3])
    return EstimatorState(line, orders, then, jnp.array(0, jnp.int32))


def update(
    settings: Estimator, known: EstimatorModel, before: EstimatorState, measured: Reading
) -> tuple[EstimatorState, Reading, Float[Array, " j"] | None]:
    """Process a measurement, one time step after the last one; return the next state and the present estimate.

    The first measurement also stands for all earlier ones. Returned are also the rates that the thrusts have when those
    of this tick begin to act [N/s]; `None` without engines.
    """
    # Selected before the computation, so that values and derivatives of the first tick do not depend on `start`.
    always = jax.tree.map(lambda old, new: jnp.broadcast_to(new, old.shape), before.line, measured)
    line, reading = where(before.ticks == 0, (always, measured), (before.line, before.then.reading))
    line = jax.tree.map(lambda old, new: jnp.concatenate([new[None], old[:-1]]), line, measured)
    then, oldest = before.then._replace(reading=reading), settings.greatest_age
    # Inputs of `age` ticks ago; the first ones also stand for the time before (M140).
    whole, torque_lag, thrust_lag = settings.latency, *settings.lags

    def given_at(age: Array | int) -> Order:
        place = jnp.minimum(age, jnp.maximum(before.ticks, 1)) - 1
        order: Order = jax.tree.map(lambda x: x[place], before.orders)
        return order

    def acting(age: Array | int, late: tuple[float, float]) -> Order:
        """Return these inputs with the torques and thrust rates that act under them, the earlier ones for a share."""

        def mixed(lag: float, share: float, name: str) -> Array:
            earlier, later = (getattr(given_at(age + int(ticks)), name) for ticks in (np.ceil(lag), np.floor(lag)))
            sent: Array = share * earlier + (1.0 - share) * later if share else later
            return sent

        return given_at(age)._replace(
            torque=mixed(torque_lag, late[0], "torque"), thrust_rate=mixed(thrust_lag, late[1], "thrust_rate")
        )

    late, longest, step = (torque_lag, thrust_lag % 1.0), oldest - whole, settings.time_step
    then = where(before.ticks > longest, advance(known, then, acting(oldest + 1, late), step), then)
    then = _correct(settings, then, line, jnp.array(oldest, jnp.int32))

    def predict(now: Estimate, age: Array) -> tuple[Estimate, None]:
        # What is younger than the latest measurement is only predicted: its age is below all of the channels.
        moved = _correct(settings, advance(known, now, acting(age + 1, late), step), line, age)
        is_past = (before.ticks > 0) & (age < whole + jnp.minimum(longest, before.ticks))
        return where(is_past, moved, now), None

    now, _ = jax.lax.scan(predict, then, jnp.arange(oldest, dtype=jnp.int32)[::-1])
    if torque_lag:
        # To when the torques of this tick begin to act.
        sent = acting(0, (1.0, 1.0))
        part = given_at(1)._replace(torque=sent.torque, thrust_rate=sent.thrust_rate)
        now = where(before.ticks > 0, advance(known, now, part, torque_lag * step), now)
    reached, rate = now.reading.thrust, now.thrust_rate
    if rate is not None:
        for age in range(int(thrust_lag), 0, -1):
            commanded = given_at(age).thrust_rate
            reached, rate = predict_thrust(reached, rate, commanded, step, known.robot.jets.thrust_min, known.engines)
    return EstimatorState(line, before.orders, then, before.ticks + 1), now.reading, rate


def is_possible(robot: RobotModel, estimate: Reading) -> Bool[Array, ""]:
    """Return whether a robot can move so; a prediction that diverges is worth less than a late measurement."""
    state, thrust = estimate
    bounded = {
        "base": state.base_position,
        "speed": state.velocity[:3],
        "angular velocity": state.velocity[3:6],
        "joints": jnp.concatenate([state.joint_position, state.velocity[6:]]),
        "thrust": thrust / robot.jets.thrust_max,
    }
    are_within = [jnp.all(jnp.abs(numbers) <= GREATEST[name]) for name, numbers in bounded.items()]
    return jnp.all(jnp.stack([*are_within, jnp.all(jnp.isfinite(state.base_rotation))]))


def command(state: EstimatorState, order: Order) -> EstimatorState:
    """Return the state with the inputs that act from this tick to the next."""
    return state._replace(
        orders=jax.tree.map(lambda old, new: jnp.concatenate([new[None], old[:-1]]), state.orders, order)
    )


def replace_command(
    state: EstimatorState, more_torque: Float[Array, " n"], thrust_rate: Float[Array, " j"]
) -> EstimatorState:
    """Return the state with other thrust rates in the last command [N/s], and so much more torque [N m]."""
    orders = state.orders
    return state._replace(
        orders=orders._replace(
            torque=orders.torque.at[0].add(more_torque), thrust_rate=orders.thrust_rate.at[0].set(thrust_rate)
        )
    )


def advance(known: EstimatorModel, estimate: Estimate, order: Order, step: Float[Array, ""]) -> Estimate:
    """Integrate the model for `step` [s] under its inputs and unexplained joint accelerations, semi-implicitly."""
    (state, thrust), disturbance = estimate.reading, estimate.disturbance
    robot, aero, engines = known
    kin = kinematics(robot, state)
    dyn = dynamics(robot, state, kin)
    link = link_forces(aero, robot, kin, LinkConventions(), order.wind)
    force = (
        generalised_thrust(robot, kin, thrust)
        + generalised_aero_force(robot, kin, link, link.jacobian_points)
        + jnp.concatenate([jnp.zeros_like(order.unmodelled), order.torque])
    )
    # The unmodelled wrench moves the robot as a whole, since its point of action is unknown. Unexplained joint
    # accelerations are internal and do not change the momentum.
    wrench = order.unmodelled - dyn.momentum_matrix[:, 6:] @ disturbance
    angular = solve_positive_definite(dyn.centroidal_inertia, wrench[3:, None])[:, 0]
    linear = wrench[:3] / robot.mass - cross(angular, kin.com - state.base_position)
    whole = jnp.concatenate([linear, angular, disturbance])
    velocity = state.velocity + step * (forward_dynamics(dyn, force) + whole)
    present = jnp.zeros_like(thrust) if estimate.thrust_rate is None else estimate.thrust_rate
    thrust, rate = predict_thrust(thrust, present, order.thrust_rate, step, robot.jets.thrust_min, engines)
    reading = Reading(move(state, velocity, step), thrust)
    return estimate._replace(reading=reading, thrust_rate=None if engines is None else rate)


def _correct(settings: Estimator, estimate: Estimate, line: Reading, age: Array) -> Estimate:
    """Correct an estimate of an age [ticks] by what has arrived of its time, each by its share (M91, M93, M145).

    `line` has the last measurements, the latest first.
    """
    since, step = age - settings.age, settings.time_step
    has_arrived = since >= 0
    share = jnp.where(has_arrived, settings.share, 0.0)
    places = jnp.maximum(since, 0)
    (now, thrust), measured = estimate.reading, line.state

    turned, turning = measured.base_rotation[places[3]], measured.velocity[places[3], 3:6]
    gyro = now.base_rotation.T @ now.velocity[3:6]
    gyros = gyro + share[3] * (turned.T @ turning - estimate.gyro_bias - gyro)
    turn = share[1] * log_so3(multiply(now.base_rotation.T, measured.base_rotation[places[1]]))
    base_rotation = project_to_so3(multiply(now.base_rotation, exp_so3(turn)))
    of_velocity, of_acceleration = jnp.where(has_arrived[4], settings.by_position, 0.0)
    innovation = measured.joint_position[places[4]] - now.joint_position

    def correct_channel(channel: int, estimated: Array, arrived: Array) -> Array:
        return estimated + share[channel] * (arrived - estimated)

    rates = now.velocity[6:] + of_velocity / step * innovation
    state = State(
        base_position=correct_channel(0, now.base_position, measured.base_position[places[0]]),
        base_rotation=base_rotation,
        joint_position=now.joint_position + share[4] * innovation,
        velocity=join(
            correct_channel(2, now.velocity[:3], measured.velocity[places[2], :3]),
            base_rotation @ gyros,
            correct_channel(5, rates, measured.velocity[places[5], 6:]),
        ),
    )
    return Estimate(
        Reading(state, jnp.maximum(correct_channel(6, thrust, line.thrust[places[6]]), 0.0)),
        estimate.thrust_rate,
        estimate.disturbance + of_acceleration / step**2 * innovation,
        estimate.gyro_bias - settings.of_bias / step * turn,
    )
