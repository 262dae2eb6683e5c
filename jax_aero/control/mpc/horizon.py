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
shortest knot, and squares of it. A thrust or joint is a chain of states that its own input drives alone. Everything at
the ends of the knots is then affine in the unknowns; H and g collect the squares of the outputs' errors. Equations M120
to M126 and M174 of `docs/model`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
    by_rates: Float[Array, "K j i"]
    """Thrusts by their own inputs."""
    by_commands: Float[Array, "K f i"]
    """Joint positions by their own inputs."""
    by_joints: Float[Array, "p f"]
    """Distances by the joint positions [m/rad]."""
    free: Float[Array, " m"]
    """Limited values without inputs [N, rad, m]."""
    least: Float[Array, " m"]
    greatest: Float[Array, " m"]
    weight: Float[Array, " m"]
    """`ρ` of the cost `½ ρ (x − b)²` of a value x beyond its limit b."""
    engines: EngineHorizon | None
    """`None` for ideal jets."""

    def changes(self, u: Float[Array, " u"]) -> Float[Array, " m"]:
        """Return what the inputs add to the limited values; distances follow the positions of the joints."""
        thrusts, commands = self._split(u)
        of_thrusts = jnp.sum(self.by_rates * thrusts.T, axis=-1)
        of_joints = jnp.sum(self.by_commands * commands.T, axis=-1)
        return jnp.concatenate([of_thrusts, of_joints, dot(of_joints, self.by_joints.T)], axis=1).reshape(-1)

    def slope(self, factors: Float[Array, " m"]) -> Float[Array, " u"]:
        """Return the derivative by the inputs of the sum of the limited values with these factors."""
        jets, free = self.by_rates.shape[1], self.by_commands.shape[1]
        thrusts, joints, apart = jnp.split(factors.reshape(self.by_rates.shape[0], -1), [jets, jets + free], axis=1)
        joints = joints + dot(apart, self.by_joints)
        by_thrusts = jnp.sum(thrusts[:, :, None] * self.by_rates, axis=0)
        by_joints = jnp.sum(joints[:, :, None] * self.by_commands, axis=0)
        return jnp.concatenate([by_thrusts.T.reshape(-1), by_joints.T.reshape(-1)])

    def _split(self, u: Array) -> tuple[Array, Array]:
        """Return the inputs of thrusts (i, j) and of joints (i, f)."""
        _, jets, inputs = self.by_rates.shape
        thrusts, commands = jnp.split(u, [jets * inputs])
        return thrusts.reshape(inputs, jets), commands.reshape(self.by_commands.shape[2], self.by_commands.shape[1])

    def beyond(self, u: Float[Array, " u"]) -> Int[Array, " m"]:
        """Return which values the inputs bring beyond their limits: -1 below, 1 above, 0 within."""
        value = self.free + self.changes(u)
        return (value > self.greatest).astype(jnp.int8) - (value < self.least).astype(jnp.int8)

    def problem(self, beyond: Int[Array, " m"], lower: Float[Array, " u"], upper: Float[Array, " u"]) -> BoxQp:
        """Return the QP that contains the cost of these values beyond their limits."""
        over = self.free - jnp.where(beyond > 0, self.greatest, self.least)
        weight = jnp.where(beyond == 0, 0.0, self.weight)
        g = self.g + self.slope(jnp.where(beyond == 0, 0.0, weight * over))
        # A thrust depends on its own inputs alone; distances on positions of joints, which do.
        (knots, jets, _), free = self.by_rates.shape, self.by_commands.shape[1]
        thrusts, joints, apart = jnp.split(weight.reshape(knots, -1), [jets, jets + free], axis=1)
        of_thrusts = jnp.einsum("kj,kja,kjb->abj", thrusts, self.by_rates, self.by_rates)
        of_joints = jnp.einsum("kp,pf,pg->kfg", apart, self.by_joints, self.by_joints)
        of_joints = of_joints + joints[:, :, None] * jnp.eye(free, dtype=joints.dtype)
        h = jnp.einsum("kfa,kfg,kgb->afbg", self.by_commands, of_joints, self.by_commands)
        h = add_blocks(self.h, of_thrusts, h.reshape(h.shape[0] * free, -1))
        return BoxQp(0.5 * (h + h.T), g, lower, upper)

    def least_on_way(self, start: Float[Array, " u"], end: Float[Array, " u"]) -> Float[Array, ""]:
        """Return the share of the way between two inputs at which the cost with all excesses is least.

        The cost is convex and piecewise quadratic: the zero of its derivative is found by bisection.
        """
        way = end - start
        slope, curvature = dot(dot(self.h, start) + self.g, way), dot(dot(self.h, way), way)
        value, step = self.free + self.changes(start), self.changes(way)

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


def add_blocks(
    h: Float[Array, "u u"], of_jets: Float[Array, "a b j"], of_joints: Float[Array, "v v"]
) -> Float[Array, "u u"]:
    """Add what depends on the own inputs of each jet (a, b, j), and on those of joints (a f, b g), to H (u, u)."""
    inputs, _, jets = of_jets.shape
    eye = jnp.eye(jets, dtype=h.dtype)
    block = (jnp.swapaxes(of_jets, 1, 2)[..., None] * eye[None, :, None]).reshape(inputs, jets, inputs, jets)
    first = inputs * jets
    return h.at[:first, :first].add(block.reshape(first, first)).at[first:, first:].add(of_joints)


class _Chains(NamedTuple):
    """Chains of states of one kind: one input drives each."""

    names: tuple[str, ...]
    """Of the states, and of the input last."""
    rates: Float[Array, "c d g"]
    """Derivatives of the states of every chain by its states, and by its input last: `d = c + 1`."""
    now: Float[Array, "c g"]
    """Present states."""
    acts: np.ndarray
    """Which of the chain's inputs acts in which knot (K, i)."""


class _Places:
    """Where the parts of `z` stand: the motion, then the states and inputs of chains, then what is not chosen."""

    def __init__(self, jets: int, free: int, *, has_engines: bool) -> None:
        sizes = {"p": 3, "v": 3, "theta": 3, "k": 3, "t": jets, "speed": jets * has_engines, "rate": jets}
        sizes |= {"s": free, "sigma": free, "e": free, "command": free, "wrench": 6, "one": 1}
        ends = np.cumsum(list(sizes.values())).tolist()
        self.of = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
        self.core = self.of["k"].stop
        self.jets, self.joints = (
            slice(self.core, self.of["rate"].stop),
            slice(self.of["s"].start, self.of["command"].stop),
        )
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

    def through(self, rows: Array, jets: Array, joints: Array) -> Array:
        """Return what rows over `z` become through states of chains, which change by (c, d, g) each."""
        found = jnp.zeros_like(rows)
        for place, by in ((self.jets, jets), (self.joints, joints)):
            states = rows[:, place].reshape(rows.shape[0], *by.shape[1:])
            found = found.at[:, place].set(_along(states, by).reshape(rows.shape[0], -1))
        return found

    def inputs(self, rows: Array) -> Array:
        """Return rows over `z` without motion and states of chains."""
        kept = np.zeros(self.size)
        for name in ("rate", "command", "wrench", "one"):
            kept[self.of[name]] = 1.0
        return rows * jnp.asarray(kept, rows.dtype)


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
    core = _core(places, robot.mass, linear, now, model, sigma_now)
    jets, joints = _jets(structure, engines, now), _joints(structure, gains, sigma_now)
    steps = _steps(structure, places, core, jets, joints)
    rates, commands = (_propagate_chains(chains, each) for chains, each in ((jets, steps.jets), (joints, steps.joints)))
    motion_by = _propagate(places, steps.core, rates, commands, wrenches)

    position = now.state.joint_position[moved]
    com, velocity = model.kinematics.com, model.dynamics.momentum[:3] / robot.mass
    motion = target._replace(position=target.position - com[None], velocity=target.velocity - velocity[None])
    turn = _turning(places, core, joints, linear, now)
    of_chains = jnp.broadcast_to(turn, (len(structure.durations), *turn.shape))
    turning = dot(turn[:, : places.core], motion_by)
    turning = turning + _by_chains(places, of_chains, rates.after, commands.after, wrenches)
    errors = jnp.concatenate([motion_by[:, : of["theta"].stop], turning], axis=1)
    errors = errors.at[:, :, -1].add(-jnp.concatenate(motion, axis=1))
    durations = jnp.asarray(np.array(structure.durations), errors.dtype)
    of_errors = _error_weights(weights)
    rows = jnp.concatenate([errors.reshape(-1, errors.shape[-1]), _tail(mpc, errors[-1])])
    squares = jnp.concatenate([(durations[:, None] * of_errors).reshape(-1), jnp.repeat(weights.tail, 3)])
    cost = dot(rows.T, squares[:, None] * rows)
    # What one chain drives alone is no dense row.
    driven, away = rates.after[:, 1:], commands.after.at[:, 0, :, -1].add(position - posture[moved])
    of_input = weights.thrust_rate * (1.0 if engines is None else INPUT_TIME**2)
    of_rates = jnp.stack([weights.thrust_rate, of_input][-driven.shape[1] :])
    of_jets = jnp.einsum("k,r,krja,krjb->abj", durations, of_rates, driven, driven)
    of_commands = jnp.stack([weights.joint_velocity, jnp.zeros_like(of_input), weights.joint_command])
    of_joints = jnp.einsum("k,r,krfa,krfb->abf", durations, of_commands, away[:, 1:], away[:, 1:])
    of_joints = of_joints + jnp.einsum("k,f,kfa,kfb->abf", durations, weights.posture, away[:, 0], away[:, 0])
    eye = jnp.eye(moved.size, dtype=of_joints.dtype)
    own = jnp.swapaxes(of_joints[:-1, :-1], 1, 2)[..., None] * eye[None, :, None]
    size = own.shape[0] * moved.size
    h = add_blocks(cost[:-1, :-1], of_jets[:-1, :-1], own.reshape(size, size))
    g = cost[:-1, -1] + jnp.concatenate([of_jets[:-1, -1].reshape(-1), of_joints[:-1, -1].reshape(-1)])

    distance, by_joint = distances(robot, mpc.clearance, structure.joints, now.state.joint_position)
    thrust, rest = (own[:, 0, :, -1] for own in (rates.after, commands.after))
    free = jnp.concatenate([thrust, rest, dot(rest, by_joint.T)], axis=1).reshape(-1)

    def at_knots(thrusts: Array, joints: Array, distances: Array) -> Array:
        return jnp.tile(jnp.concatenate([thrusts, joints, distances]), len(structure.durations))

    least = robot.jets.thrust_min, robot.joint_limits[moved, 0], jnp.full_like(distance, LEAST_DISTANCE)
    greatest = robot.jets.thrust_max, robot.joint_limits[moved, 1], jnp.full_like(distance, jnp.inf)
    values = now.thrust, position, distance
    factors: tuple[Array | float, ...] = mpc.thrust_excess, JOINT_EXCESS, CLEARANCE_WEIGHT
    excess = (jnp.full_like(value, weight) for value, weight in zip(values, factors, strict=True))
    return Horizon(
        h=0.5 * (h + h.T),
        g=g,
        by_rates=rates.after[:, 0, :, :-1],
        by_commands=commands.after[:, 0, :, :-1],
        by_joints=by_joint,
        free=free + at_knots(*values),
        least=at_knots(*least),
        greatest=at_knots(*greatest),
        weight=at_knots(*excess),
        engines=_engine_horizon(engines, now.thrust, rates.before[..., -1]),
    )


def _engine_horizon(engines: Engines | None, thrust: Array, states: Array) -> EngineHorizon | None:
    """Return what the inputs may be, from changes and rates of the thrusts before the knots without inputs."""
    if engines is None:
        return None
    change, rates = states[:, 0], states[:, 1]
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


def _core(
    places: _Places, mass: float | Array, linear: Linearised, now: Measurement, model: Model, sigma_now: Array
) -> Array:
    """Return the rows with which `z` changes the motion (12, N)."""
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
    return core.at[:, -1].add(-core[:, places.of["sigma"]] @ sigma_now)


def _jets(structure: Structure, engines: Engines | None, now: Measurement) -> _Chains:
    """Return the chains of the thrusts: an input in every knot."""
    acts, zero = np.eye(len(structure.durations)), jnp.zeros_like(now.thrust)
    one = jnp.ones_like(zero)
    if engines is None:
        return _Chains(("t", "rate"), jnp.stack([jnp.stack([zero, one])]), zero[None], acts)
    by_thrust, by_rate = acceleration_slopes(engines, now.thrust)
    rates = jnp.stack([jnp.stack([zero, one, zero]), jnp.stack([by_thrust, by_rate, one])])
    begun = jnp.stack([zero, zero if now.thrust_rate is None else now.thrust_rate])
    return _Chains(("t", "speed", "rate"), rates, begun, acts)


def _joints(structure: Structure, gains: tuple[Array, Array], sigma_now: Array) -> _Chains:
    """Return the chains of the joints: an input in every block."""
    kd, kp = (jnp.asarray(gain) for gain in gains)
    zero, one = jnp.zeros_like(kd), jnp.ones_like(kd)
    rates = jnp.stack(
        [
            jnp.stack([zero, one, zero, zero]),
            jnp.stack([zero, -kd, -kp, kd]),
            jnp.stack([zero, one, zero, -one]),
        ]
    )
    rest = jnp.zeros_like(sigma_now)
    acts = np.eye(structure.blocks[-1] + 1)[np.array(structure.blocks)]
    of_each = jnp.broadcast_to(rates[..., None], (*rates.shape, sigma_now.size))
    return _Chains(("s", "sigma", "e", "command"), of_each, jnp.stack([rest, sigma_now, rest]), acts)


def _along(x: Array, by: Array) -> Array:
    """Return the product of matrices of chains: (a, d, g), of which the last of d is the input, by (c, d, g)."""
    return jnp.sum(x[:, : by.shape[0], None] * by[None], axis=1)


def _turning(places: _Places, core: Array, joints: _Chains, linear: Linearised, now: Measurement) -> Array:
    """Return ω, a and α by `z` (9, N): `α = ω_θ θ̇ + ω_k k̇ + ω_s ṡ + ω_ṡ s̈`."""
    of = places.of
    # ω itself has no half of S(ω), which belongs to θ̇.
    omega = core[of["theta"]].at[:, of["theta"]].add(-0.5 * skew(now.state.velocity[3:6]))
    alpha = dot(linear.omega_theta, core[of["theta"]]) + dot(linear.omega_k, core[of["k"]])
    of_joints = {
        name: linear.omega_s * joints.rates[0, place][None] + linear.omega_sigma * joints.rates[1, place][None]
        for place, name in enumerate(joints.names)
    }
    return jnp.concatenate([omega, core[of["v"]], alpha + places.rows(core.dtype, **of_joints)])


class _Steps(NamedTuple):
    """Transitions over every knot, by the values before it and the inputs in it."""

    core: Float[Array, "K 12 N"]
    jets: Float[Array, "K c d j"]
    joints: Float[Array, "K 3 4 f"]


def _steps(structure: Structure, places: _Places, core: Array, jets: _Chains, joints: _Chains) -> _Steps:
    """Return the transitions: the exponential of the matrix by a Taylor series for the shortest knot, then squares.

    Rows of the motion, of chains, and of inputs, which do not change, are kept apart.
    """
    shortest = structure.durations[0]

    def one(like: Array) -> Array:
        eye = jnp.eye(like.shape[0], like.shape[1], dtype=like.dtype)
        return jnp.broadcast_to(eye if like.ndim == 2 else eye[..., None], like.shape)

    def add(sums: tuple[Any, Any], order: Array) -> tuple[tuple[Any, Any], None]:
        total, power = sums
        motion = dot(power[0][:, : places.core], core) + places.through(power[0], jets.rates, joints.rates)
        moved = motion, _along(power[1], jets.rates), _along(power[2], joints.rates)
        power = tuple(each * (shortest / order) for each in moved)
        return (tuple(a + b for a, b in zip(total, power, strict=True)), power), None

    start = one(core), one(jets.rates), one(joints.rates)
    first: tuple[Array, ...] = lax.scan(add, (start, start), jnp.arange(1, TERMS + 1, dtype=core.dtype))[0][0]
    steps = [first]
    for _ in range(max(structure.doublings)):
        motion, *driven = half = steps[-1]
        twice = dot(motion[:, : places.core], motion) + places.through(motion, *driven) + places.inputs(motion)
        # A chain's input stays.
        steps.append((twice, *(_along(each, each) + each.at[:, :-1].set(0.0) for each in half[1:])))
    chosen = np.array(structure.doublings)
    return _Steps(*(jnp.stack(each)[chosen] for each in zip(*steps, strict=True)))


class _Driven(NamedTuple):
    """States of chains, and their input, by their own inputs and without any: (K, c + 1, g, i + 1)."""

    before: Array
    """Before every knot."""
    after: Array
    """After it."""


def _propagate_chains(chains: _Chains, steps: Array) -> _Driven:
    """Return the states of chains along the knots."""
    knots, inputs = chains.acts.shape
    count, size = chains.now.shape
    acts = jnp.broadcast_to(
        jnp.asarray(np.pad(chains.acts, ((0, 0), (0, 1))), steps.dtype)[:, None, None], (knots, 1, size, inputs + 1)
    )
    start = jnp.zeros((count, size, inputs + 1), steps.dtype).at[..., -1].set(chains.now)

    def advance(states: Array, knot: tuple[Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        step, act = knot
        driven = jnp.concatenate([states, act])
        after = jnp.sum(step[..., None] * driven[None], axis=1)
        return after, (driven, jnp.concatenate([after, act]))

    return _Driven(*lax.scan(advance, start, (steps, acts))[1])


def _propagate(places: _Places, steps: Array, rates: _Driven, commands: _Driven, wrenches: Array) -> Array:
    """Return the motion at the ends of the knots (K, 12, u + 1), by every unknown and without any; it is zero now."""
    # Within a knot the mean of both ends: it needs no wind but that of the ends, where ω, a and α do.
    means = 0.5 * (wrenches + jnp.concatenate([jnp.zeros_like(wrenches[:1]), wrenches[:-1]]))
    added = _by_chains(places, steps, rates.before, commands.before, means)

    def advance(motion: Array, knot: tuple[Array, Array]) -> tuple[Array, Array]:
        step, more = knot
        motion = dot(step[:, : places.core], motion) + more
        return motion, motion

    propagated: Array = lax.scan(advance, jnp.zeros_like(added[0]), (steps, added))[1]
    return propagated


def _by_chains(places: _Places, rows: Array, jets: Array, joints: Array, wrenches: Array) -> Array:
    """Return products of rows over `z` (K, a, N) with all of it but the motion, by all unknowns and without any.

    (K, a, u + 1), of thrusts first. An unknown drives one chain, so `z` itself would be full of zeros.
    """

    def along(place: slice, chains: Array) -> tuple[Array, Array]:
        parts = rows[:, :, place].reshape(*rows.shape[:2], *chains.shape[1:3])
        by = jnp.einsum("kadg,kdgi->kaig", parts, chains, precision="highest")
        return by[:, :, :-1].reshape(*rows.shape[:2], -1), by[:, :, -1].sum(-1)

    (by_jets, of_jets), (by_joints, of_joints) = along(places.jets, jets), along(places.joints, joints)
    of_air = jnp.einsum("kaw,kw->ka", rows[:, :, places.of["wrench"]], wrenches, precision="highest")
    free = of_jets + of_joints + of_air + rows[:, :, -1]
    return jnp.concatenate([by_jets, by_joints, free[:, :, None]], axis=2)


def _error_weights(weights: MpcWeights) -> Array:
    """Return the weights of a knot's errors (18,): p, v, θ, ω, a and α."""
    turning = (weights.angular_velocity, weights.acceleration, weights.angular_acceleration)
    spread = (jnp.broadcast_to(jnp.asarray(each), (3,)) for each in turning)
    return jnp.concatenate([weights.position, weights.velocity, weights.attitude, *spread])
