"""The prediction over the horizon, and the QP in its inputs.

```text
w                        change of the wrench of the air with the wind ahead
y = (δp, δv, θ, δk)      motion of the centre of mass, rotation, angular momentum; the present one is zero
d = (δT, Ṫ, δs, ṡ, δe)   thrusts, joints, their velocities and velocity errors: driven by the inputs alone
u = (u_T, ṡ*)            inputs of the thrusts; joint velocities of the moved joints
Ṫ = u_T                  ideal jets, whose rates are no states
T̈ = α δT + β Ṫ + u_T     engines about the steady thrust T, at the throttle that holds it (M174)
ẏ = A_c y + A_d d + B w + c    δë of the torque law: s̈ = K_D (ṡ* − ṡ) − K_P δe,  δė = ṡ − ṡ*
```

`z = (y, d, u, w, 1)` has one constant matrix over a knot, in which `u` and `w` do not change: a Taylor series for the
shortest knot, and squares of it. Everything at the ends of the knots is then affine in the unknowns; H and g collect
the squares of the outputs' errors. Equations M120 to M126 and M174 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from jax_aero.body.jets import Engines, acceleration_range, acceleration_slopes
from jax_aero.body.linalg import dot
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import skew
from jax_aero.control.measurement import Measurement
from jax_aero.control.mpc.clearance import CLEARANCE_WEIGHT, LEAST_DISTANCE, distances
from jax_aero.control.mpc.config import JOINT_EXCESS, Mpc, MpcWeights, Structure
from jax_aero.control.mpc.model import Linearised
from jax_aero.control.qp import BoxQp
from jax_aero.control.terms import Model
from jax_aero.types import Array

TERMS = 16
"""Terms of the Taylor series: with `K_D h = 0.2` the remainder is below rounding."""

INPUT_TIME = 0.03
"""Time that makes the input of an engine [N/s²] comparable with a thrust rate [s]."""

BISECTIONS = 40
"""Steps of the bisection for the least cost on a way."""


class Target(NamedTuple):
    """Motion that the robot should have at the end of every knot, inertial axes."""

    position: Float[Array, "K 3"]
    """Centre of mass [m]."""
    velocity: Float[Array, "K 3"]
    """[m/s]."""
    rotation: Float[Array, "K 3"]
    """Rotation vector from the present attitude [rad]."""
    angular_velocity: Float[Array, "K 3"]
    """[rad/s]."""
    acceleration: Float[Array, "K 3"]
    """[m/s²]."""
    angular_acceleration: Float[Array, "K 3"]
    """[rad/s²]."""


class EngineHorizon(NamedTuple):
    """What the engines' inputs may be."""

    damping: Float[Array, " j"]
    """`β` [1/s]."""
    least: Float[Array, "K j"]
    """Least inputs in every knot, from the limits of the throttle along the motion without inputs [N/s²]."""
    greatest: Float[Array, "K j"]


class Horizon(NamedTuple):
    """Cost and limited values of the inputs `u`; `m` thrusts, joints and distances at the ends of the knots."""

    h: Float[Array, "u u"]
    g: Float[Array, " u"]
    by_inputs: Float[Array, "m u"]
    """Limited values by the inputs."""
    free: Float[Array, " m"]
    """Limited values without inputs [N, rad, m]."""
    least: Float[Array, " m"]
    greatest: Float[Array, " m"]
    weight: Float[Array, " m"]
    """`ρ` of the cost `½ ρ (x − b)²` of a value x beyond its limit b."""
    engines: EngineHorizon | None
    """`None` for ideal jets."""

    def beyond(self, u: Float[Array, " u"]) -> Int[Array, " m"]:
        """Return which values the inputs bring beyond their limits: -1 below, 1 above, 0 within."""
        value = self.free + dot(self.by_inputs, u)
        return (value > self.greatest).astype(jnp.int8) - (value < self.least).astype(jnp.int8)

    def problem(self, beyond: Int[Array, " m"], lower: Float[Array, " u"], upper: Float[Array, " u"]) -> BoxQp:
        """Return the QP that contains the cost of these values beyond their limits."""
        over = self.free - jnp.where(beyond > 0, self.greatest, self.least)
        weighted = jnp.where(beyond == 0, 0.0, self.weight)[:, None] * self.by_inputs
        h = dot(self.by_inputs.T, weighted)
        return BoxQp(self.h + 0.5 * (h + h.T), self.g + dot(jnp.where(beyond == 0, 0.0, over), weighted), lower, upper)

    def least_on_way(self, start: Float[Array, " u"], end: Float[Array, " u"]) -> Float[Array, ""]:
        """Return the share of the way between two inputs at which the cost with all excesses is least.

        The cost is convex and piecewise quadratic: the zero of its derivative is found by bisection.
        """
        way = end - start
        slope, curvature = dot(dot(self.h, start) + self.g, way), dot(dot(self.h, way), way)
        value, step = self.free + dot(self.by_inputs, start), dot(self.by_inputs, way)

        def derivative(share: Array) -> Array:
            at = value + share * step
            excess = at - jnp.clip(at, self.least, self.greatest)
            return slope + share * curvature + jnp.sum(self.weight * excess * step)

        def halve(_: Array, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
            least, greatest = bracket
            middle = 0.5 * (least + greatest)
            is_past = derivative(middle) > 0.0
            return jnp.where(is_past, least, middle), jnp.where(is_past, middle, greatest)

        ends = jnp.zeros_like(slope), jnp.ones_like(slope)
        return jnp.where(derivative(ends[1]) <= 0.0, 1.0, lax.fori_loop(0, BISECTIONS, halve, ends)[1])


class _Places:
    """Where the parts of `z` stand."""

    def __init__(self, jets: int, free: int, *, has_engines: bool) -> None:
        sizes = {"p": 3, "v": 3, "theta": 3, "k": 3, "t": jets, "speed": jets * has_engines}
        sizes |= {"s": free, "sigma": free, "e": free}
        sizes |= {"rate": jets, "command": free, "wrench": 6, "one": 1}
        ends = np.cumsum(list(sizes.values())).tolist()
        self.of = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
        self.core = self.of["k"].stop
        self.states = self.of["e"].stop
        self.size = self.of["one"].stop

    def rows(self, dtype: np.dtype[np.generic], **parts: Array) -> Array:
        """Return rows over all of `z` from their parts; those that are not given are zero."""
        count = next(iter(parts.values())).shape[0]
        return jnp.concatenate(
            [
                parts[name] if name in parts else jnp.zeros((count, place.stop - place.start), dtype)
                for name, place in self.of.items()
            ],
            axis=1,
        )


def horizon(
    mpc: Mpc,
    engines: Engines | None,
    gains: tuple[Float[Array, ""], Float[Array, ""]],
    robot: RobotModel,
    linear: Linearised,
    now: Measurement,
    model: Model,
    posture: Float[Array, " n"],
    target: Target,
    wrenches: Float[Array, "K 6"],
) -> Horizon:
    """Build the QP for the gains `K_D` [1/s] and `K_P` [1/s²] of the torque law.

    `engines` follow the thrust rates; without any thrusts do so themselves. `posture` are the wanted positions of the
    joints [rad], `wrenches` the changes of the air's wrench with the wind at the ends of the knots [N, N m].
    """
    structure, weights, moved = mpc.structure, mpc.weights, np.array(mpc.structure.joints, dtype=int)
    places = _Places(now.thrust.shape[0], moved.size, has_engines=engines is not None)
    of, sigma_now = places.of, now.state.velocity[6 + moved]
    slopes = None if engines is None else acceleration_slopes(engines, now.thrust)
    dynamics = _dynamics(places, robot.mass, linear, now, model, gains, sigma_now, slopes)
    start = jnp.zeros(places.states, sigma_now.dtype).at[of["sigma"]].set(sigma_now)
    if engines is not None and now.thrust_rate is not None:
        start = start.at[of["speed"]].set(now.thrust_rate)
    z = _propagate(structure, places, dynamics, start, wrenches)

    position = now.state.joint_position[moved]
    com, velocity = model.kinematics.com, model.dynamics.momentum[:3] / robot.mass
    motion = target._replace(position=target.position - com[None], velocity=target.velocity - velocity[None])
    errors = dot(_outputs(places, dynamics, linear, now), z.at[:, of["wrench"], -1].set(wrenches))
    errors = errors.at[:, :, -1].add(-jnp.concatenate(motion, axis=1))
    s = z[:, of["s"]]
    away = s.at[:, :, -1].add(position - posture[moved])
    driven = [z[:, of[name]] for name in ("sigma", "speed", "rate", "command")]
    by_knot = jnp.concatenate([errors, away, *driven], axis=1)
    squares = np.array(structure.durations)[:, None] * _squares(weights, places)[None]
    rows = jnp.concatenate([by_knot.reshape(-1, by_knot.shape[-1]), _tail(mpc, errors[-1])])
    cost = dot(rows.T, jnp.concatenate([squares.reshape(-1), jnp.repeat(weights.tail, 3)])[:, None] * rows)

    distance, by_joint = distances(robot, mpc.clearance, structure.joints, now.state.joint_position)
    limited = jnp.concatenate([z[:, of["t"]], s, dot(by_joint, s)], axis=1)

    def at_knots(thrusts: Array, joints: Array, distances: Array) -> Array:
        return jnp.tile(jnp.concatenate([thrusts, joints, distances]), len(structure.durations))

    least = robot.jets.thrust_min, robot.joint_limits[moved, 0], jnp.full_like(distance, LEAST_DISTANCE)
    greatest = robot.jets.thrust_max, robot.joint_limits[moved, 1], jnp.full_like(distance, jnp.inf)
    values = now.thrust, position, distance
    factors: tuple[Array | float, ...] = mpc.thrust_excess, JOINT_EXCESS, CLEARANCE_WEIGHT
    excess = (jnp.full_like(value, weight) for value, weight in zip(values, factors, strict=True))
    return Horizon(
        h=0.5 * (cost + cost.T)[:-1, :-1],
        g=cost[:-1, -1],
        by_inputs=limited[:, :, :-1].reshape(-1, limited.shape[-1] - 1),
        free=limited[:, :, -1].reshape(-1) + at_knots(*values),
        least=at_knots(*least),
        greatest=at_knots(*greatest),
        weight=at_knots(*excess),
        engines=_engine_horizon(engines, now.thrust, start[of["speed"]], z[:, of["t"], -1], z[:, of["speed"], -1]),
    )


def _engine_horizon(
    engines: Engines | None, thrust: Array, rate: Array, change: Array, rates: Array
) -> EngineHorizon | None:
    """Return what the inputs may be, from changes and rates of the thrusts at the ends of the knots without inputs."""
    if engines is None:
        return None
    change = jnp.concatenate([jnp.zeros_like(change[:1]), change[:-1]])
    rates = jnp.concatenate([rate[None], rates[:-1]])
    by_thrust, by_rate = acceleration_slopes(engines, thrust)
    free = by_thrust * change + by_rate * rates
    least, greatest = acceleration_range(engines, thrust + change, rates)
    return EngineHorizon(by_rate, least - free, greatest - free)


def _tail(mpc: Mpc, errors: Array) -> Array:
    """Return what is left of motion and attitude (6, u + 1) from the errors of the last knot's outputs.

    It is `a + 2 λ v + λ² p`; along an axis whose position has no weight only the velocity decays, `a + λ v`.
    """
    p, v, theta, omega, a, alpha = jnp.split(errors, 6)
    holds = jnp.concatenate([mpc.weights.position, mpc.weights.attitude])[:, None] > 0.0
    by_position, by_velocity = jnp.where(holds, mpc.decay**2, 0.0), jnp.where(holds, 2.0 * mpc.decay, mpc.decay)
    decaying = by_position * jnp.concatenate([p, theta]) + by_velocity * jnp.concatenate([v, omega])
    return jnp.concatenate([a, alpha]) + decaying


def _dynamics(
    places: _Places,
    mass: float | Array,
    linear: Linearised,
    now: Measurement,
    model: Model,
    gains: tuple[Array, Array],
    sigma_now: Array,
    slopes: tuple[Array, Array] | None,
) -> Array:
    """Return the matrix (N, N) with which `z` changes."""
    dtype, omega = now.state.velocity.dtype, now.state.velocity[3:6]
    by = {"v": linear.rate_v, "theta": linear.rate_theta, "k": linear.rate_k, "t": linear.rate_t}
    by |= {"s": linear.rate_s, "sigma": linear.rate_sigma, "one": model.momentum.rate_estimate[:, None]}
    by |= {"wrench": jnp.eye(6, dtype=dtype)}
    identity = jnp.eye(3, dtype=dtype)
    core = jnp.concatenate(
        [
            places.rows(dtype, v=identity, one=model.dynamics.momentum[:3, None] / mass),
            places.rows(dtype, **{name: rows[:3] / mass for name, rows in by.items()}),
            # θ̇ = J_l⁻¹(θ) ω, with J_l⁻¹ = 1 − S(θ)/2 + …
            places.rows(
                dtype,
                theta=linear.omega_theta + 0.5 * skew(omega),
                k=linear.omega_k,
                s=linear.omega_s,
                sigma=linear.omega_sigma,
                one=omega[:, None],
            ),
            places.rows(dtype, **{name: rows[3:] for name, rows in by.items()}),
        ]
    )
    # `d` holds velocities, of which the present ones are part of the present rates.
    core = core.at[:, -1].add(-core[:, places.of["sigma"]] @ sigma_now)
    jets, joints = jnp.eye(now.thrust.shape[0], dtype=dtype), jnp.eye(sigma_now.shape[0], dtype=dtype)
    kd, kp = gains
    thrusts = [places.rows(dtype, rate=jets)]
    if slopes is not None:
        by_thrust, by_rate = slopes
        thrusts = [
            places.rows(dtype, speed=jets),
            places.rows(dtype, t=by_thrust * jets, speed=by_rate * jets, rate=jets),
        ]
    return jnp.concatenate(
        [
            core,
            *thrusts,
            places.rows(dtype, sigma=joints),
            places.rows(dtype, sigma=-kd * joints, e=-kp * joints, command=kd * joints),
            places.rows(dtype, sigma=joints, command=-joints),
            jnp.zeros((places.size - places.states, places.size), dtype),
        ]
    )


def _outputs(places: _Places, dynamics: Array, linear: Linearised, now: Measurement) -> Array:
    """Return p, v, θ, ω, a and α by `z` (18, N): `α = ω_θ θ̇ + ω_k k̇ + ω_s ṡ + ω_ṡ s̈`."""
    of, values = places.of, jnp.eye(places.size, dtype=dynamics.dtype)
    # ω itself has no half of S(ω), which belongs to θ̇.
    omega = dynamics[of["theta"]].at[:, of["theta"]].add(-0.5 * skew(now.state.velocity[3:6]))
    turn = [linear.omega_theta, linear.omega_k, linear.omega_s, linear.omega_sigma]
    rates = [dynamics[of[name]] for name in ("theta", "k", "s", "sigma")]
    alpha = dot(jnp.concatenate(turn, axis=1), jnp.concatenate(rates))
    return jnp.concatenate([values[of["p"]], values[of["v"]], values[of["theta"]], omega, dynamics[of["v"]], alpha])


def _propagate(structure: Structure, places: _Places, dynamics: Array, start: Array, wrenches: Array) -> Array:
    """Return `z` at the ends of the knots (K, N, u + 1), by every unknown and without any; `start` is (y, d) now."""
    # Within a knot the mean of both ends: it needs no wind but that of the ends, where ω, a and α do.
    means = 0.5 * (wrenches + jnp.concatenate([jnp.zeros_like(wrenches[:1]), wrenches[:-1]]))
    inputs, first = jnp.asarray(_inputs(structure, places), dynamics.dtype), places.of["wrench"].start - places.states
    inputs = inputs.at[:, first : first + 6, -1].set(means)
    steps = [_exponential(dynamics * structure.durations[0])]
    for _ in range(max(structure.doublings)):
        steps.append(dot(steps[-1], steps[-1]))
    states = jnp.zeros((places.states, inputs.shape[-1]), dynamics.dtype).at[:, -1].set(start)

    def advance(states: Array, knot: tuple[Array, Array]) -> tuple[Array, Array]:
        step, inputs = knot
        z = jnp.concatenate([states, inputs])
        states = dot(step[: places.states], z)
        return states, jnp.concatenate([states, inputs])

    z: Array = lax.scan(advance, states, (jnp.stack(steps)[np.array(structure.doublings)], inputs))[1]
    return z


def _inputs(structure: Structure, places: _Places) -> np.ndarray:
    """Return which unknown acts in which knot (K, inputs to one, u + 1): thrust rates by knot, joints by block."""
    jets, free = (places.of[name].stop - places.of[name].start for name in ("rate", "command"))
    knots, unknowns = len(structure.durations), structure.unknowns(jets)
    inputs = np.zeros((knots, places.size - places.states, unknowns + 1))
    for knot, block in enumerate(structure.blocks):
        inputs[knot, np.arange(jets), knot * jets + np.arange(jets)] = 1.0
        inputs[knot, jets + np.arange(free), jets * knots + block * free + np.arange(free)] = 1.0
    inputs[:, -1, -1] = 1.0
    return inputs


def _exponential(matrix: Array) -> Array:
    """Return the exponential of a small matrix by its Taylor series."""
    one = jnp.eye(matrix.shape[0], dtype=matrix.dtype)

    def add(sums: tuple[Array, Array], order: Array) -> tuple[tuple[Array, Array], None]:
        total, power = sums
        power = dot(power, matrix) / order
        return (total + power, power), None

    return lax.scan(add, (one, one), jnp.arange(1, TERMS + 1, dtype=matrix.dtype))[0][0]


def _squares(weights: MpcWeights, places: _Places) -> Array:
    """Return the weights of a knot's errors: outputs, joints, their velocities, inputs."""
    jets, speeds, free = (places.of[name].stop - places.of[name].start for name in ("rate", "speed", "command"))
    of_input = weights.thrust_rate * (INPUT_TIME**2 if speeds else 1.0)
    counts = (
        *((weights.angular_velocity, 3), (weights.acceleration, 3), (weights.angular_acceleration, 3)),
        *(
            (weights.joint_velocity, free),
            (weights.thrust_rate, speeds),
            (of_input, jets),
            (weights.joint_command, free),
        ),
    )
    omega, a, alpha, *driven = (jnp.repeat(x, count) for x, count in counts)
    outputs = [weights.position, weights.velocity, weights.attitude, omega, a, alpha]
    return jnp.concatenate([*outputs, weights.posture, *driven])
