"""Equations of motion of a robot whose numbers differ from its file: what of a log they leave unexplained.

    r(t, θ) = M ν̇ + h − S g τ + friction − Σ Jᵀ g T a − air      what acts on the robot unexplained, all 6 + n rows

`θ` are differences from the robot's file. Every body's mass is distributed as in the file, after an affine map of its
place, so that it stays physical. Derivatives of the residual are JAX's.

Source of bodies: Rucker and Wensing, "Smooth parameterization of rigid-body inertia", RA-L 2022, here about the centre
of mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from jax_aero.aero import AeroModel, LinkConventions, generalised_aero_force, link_forces
from jax_aero.body.dynamics import dynamics
from jax_aero.body.kinematics import generalised_thrust, kinematics, kinematics_at_rest
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import cross, exp_so3, rotate, trace
from jax_aero.types import Array, State

SLIP = 0.03
"""Velocity from which dry friction is taken as most of the whole [rad/s]: it acts less on a joint that trembles."""
WIDTH = 0.05
"""Standard deviation of the Gaussian that smooths all signals alike [s]."""
UNMODELLED = (7e-4, 4.3e-4, 8.5e-4)
"""Deviation, in every sample, of forces and moments on the base and of torques that no number explains, as shares of
the weight and of the weight at the radius of gyration. Ours: of drawn robots' residuals at their truth."""
AIR = (0.3, 0.4, 0.15)
"""Share of the air's force in every frequency that no factor of a link explains, and its lever arms over the radius of
gyration, about the base and about joints: what an analytical model leaves of a network."""
CHUNK = 50
"""Samples whose derivatives are computed at once; bounds the memory."""


class Model(NamedTuple):
    """What the numbers are differences of.

    Attributes
    ----------
    posture
        Joint positions at which `com` and `inertia` are those of the whole robot (n,) [rad, m].
    """

    robot: RobotModel
    aero: AeroModel
    posture: Float[Any, " n"]


class Numbers(NamedTuple):
    """Numbers of a robot that a log may determine; zero is what its file states."""

    mass: Float[Any, ""]
    """Of the whole mass, and of all inertias with it, relative."""
    com: Float[Any, "3"]
    """Offset of the base body's centre of mass that gives the robot its own, if other bodies are the file's [m]."""
    inertia: Float[Any, ""]
    """Of all inertias about bodies' centres beside their masses, which gives the robot's, likewise; relative."""
    bodies: Float[Any, "nb 10"]
    """Of each body among the others: logarithm of its mass, place of its centre [m, body axes], and logarithms of
    three sizes and three shears (zx, zy, yx) of its mass about it."""
    fuel: Float[Any, ""]
    """Mass that the heaviest body loses by the impulse of all jets [kg/(N s)]."""
    thrust_gain: Float[Any, " j"]
    """Of the force of each jet over its thrust, relative."""
    thrust_offset: Float[Any, " j"]
    """Offset of the measured thrusts [N]."""
    thrust_axes: Float[Any, "j 2"]
    """Tilt of each jet about two axes across its thrust, of which `across` gives the directions [rad]."""
    torque_gain: Float[Any, " g"]
    """Of the torque that acts over the measured one, by group of joints, relative."""
    imu: Float[Any, "3"]
    """Rotation of the measured base from the true one, base axes [rad]."""
    gyro: Float[Any, "3"]
    """Rotation of the gyroscope from the base, base axes [rad]."""
    encoders: Float[Any, " n"]
    """Offset of the measured joint positions [rad, m]."""
    friction: Float[Any, " n"]
    """Dry friction of each drive [N m, N]."""
    damping: Float[Any, ""]
    """Viscous friction of all drives [N m s]."""
    air: Float[Any, " l"]
    """Of the force of the air on each link, relative."""
    air_turn: Float[Any, "l 3"]
    """Rotation of this force, axes of the link's body [rad]."""
    air_point: Float[Any, "l 3"]
    """Offset of its point, the same axes [m]."""
    wrench: Float[Any, "6"]
    """Constant force and moment on the base that nothing else explains [N, N m]."""
    wind: Float[Any, "3"]
    """Constant wind beside the measured one [m/s, inertial axes]."""
    delay: Float[Any, "2"]
    """Of thrusts and torques, beside what their samples are corrected for [s]."""


class Samples(NamedTuple):
    """Smoothed measurements of one log at k times, all of the same moment."""

    weight: Float[Any, " k"]
    """1, or 0 in samples that the equations do not cover."""
    burnt: Float[Any, " k"]
    """Impulse of all jets until then [N s]."""
    position_rate: Float[Any, "k 3"]
    """Derivative of the measured position of the base [m/s]."""
    turn_rate: Float[Any, "k 3"]
    """That of the measured attitude [rad/s, base axes]."""
    rotation: Float[Any, "k 3 3"]
    linear_velocity: Float[Any, "k 3"]
    linear_acceleration: Float[Any, "k 3"]
    gyro: Float[Any, "k 3"]
    """Angular velocity [rad/s, base axes]."""
    gyro_rate: Float[Any, "k 3"]
    joint_position: Float[Any, "k n"]
    joint_velocity: Float[Any, "k n"]
    joint_acceleration: Float[Any, "k n"]
    thrust: Float[Any, "k j"]
    thrust_rate: Float[Any, "k j"]
    thrust_noise: Float[Any, "k j"]
    """Noise in thrusts, as the root of its spectrum: white noise from sample to sample has its deviation [N]."""
    velocity_noise: Float[Any, "k 6"]
    """That of velocities and rates of turn, whose derivatives are smoothed [m/s, rad/s]."""
    torque: Float[Any, "k n"]
    torque_rate: Float[Any, "k n"]
    wind: Float[Any, "k 3"]
    feet: Float[Any, "k N"]
    """Generalised forces of the measured wrenches of the feet; zero in flight."""


def across(axis: Float[Array, "3"]) -> Float[Array, "3 2"]:
    """Return two orthogonal directions across an axis: the frame's own where the axis is one of them."""
    first = jnp.roll(jnp.eye(3), -1, axis=0)[jnp.abs(axis).argmax()]
    first = first - axis * (axis @ first)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(axis, first)], axis=1)


def robot_with(model: Model, numbers: Numbers) -> RobotModel:
    """Return the robot with these differences of masses, centres of mass, inertias and thrust axes."""
    robot, bodies = model.robot, jnp.asarray(numbers.bodies)
    axes = jax.vmap(lambda axis, tilt: exp_so3(across(axis) @ tilt) @ axis)(
        jnp.asarray(robot.jets.axes), jnp.asarray(numbers.thrust_axes)
    )
    kin = kinematics_at_rest(robot, jnp.asarray(model.posture))
    before = jnp.asarray(robot.masses)
    masses = before * jnp.exp(bodies[:, 0])
    masses = masses * ((1.0 + numbers.mass) * before.sum() / masses.sum())
    # Second moments Σ = tr(I)/2 1 − I of a body's mass about its centre, mapped by x -> F x.
    mapped = jnp.exp(bodies[:, 4:7])[:, None, :] * jnp.eye(3)
    mapped = mapped.at[:, [0, 1, 0], [2, 2, 1]].set(bodies[:, 7:])
    second = mapped @ _opposite(jnp.asarray(robot.inertias), 0.5) @ jnp.swapaxes(mapped, -1, -2)
    inertias = (masses / jnp.where(before > 0.0, before, 1.0))[:, None, None] * _opposite(second, 1.0)

    def places(coms: Array) -> Array:
        placed: Array = kin.body_positions + rotate(kin.body_rotations, coms)
        return placed

    wanted = (1.0 + numbers.mass) * (before @ places(jnp.asarray(robot.coms)) + before[0] * numbers.com)
    coms = jnp.asarray(robot.coms) + bodies[:, 1:4]
    coms = coms.at[0].add((wanted - masses @ places(coms)) / masses[0])

    def spread(masses: Array, coms: Array) -> Array:
        apart: Array = places(coms) - masses @ places(coms) / masses.sum()
        return jnp.sum(masses * jnp.sum(apart**2, axis=1))

    moved = jnp.asarray(robot.coms).at[0].add(numbers.com)
    own = (1.0 + numbers.inertia) * trace(jnp.asarray(robot.inertias)).sum() + 2.0 * spread(before, moved)
    factor = ((1.0 + numbers.mass) * own - 2.0 * spread(masses, coms)) / trace(inertias).sum()
    return replace(robot, masses=masses, coms=coms, inertias=factor * inertias, jets=replace(robot.jets, axes=axes))


def _opposite(moments: Float[Array, "nb 3 3"], share: float) -> Float[Array, "nb 3 3"]:
    """Return `share tr(A) 1 − A`: of inertias and 1/2 second moments, of these and 1 inertias."""
    opposite: Array = share * trace(moments)[:, None, None] * jnp.eye(3) - moments
    return opposite


def unexplained(model: Model, numbers: Numbers, samples: Samples) -> Float[np.ndarray, "k N"]:
    """Return what acts on the robot unexplained in every sample: on the base about its origin, and on the joints."""
    return _by_chunks(lambda part: _residuals(model, numbers, part)[0], samples)


def air_of(
    model: Model, numbers: Numbers, samples: Samples, left: Float[np.ndarray, "k N"]
) -> Float[np.ndarray, "k N"]:
    """Return the forces of the air, without which so much more than `left` is unexplained."""
    without = numbers._replace(air=-jnp.ones_like(jnp.asarray(numbers.air)))
    air: np.ndarray = unexplained(model, without, samples) - left
    return air


def mass_matrices(model: Model, numbers: Numbers, samples: Samples) -> Float[np.ndarray, "k N N"]:
    """Return the mass matrix of every sample, over the mass's factor."""
    return _by_chunks(lambda part: _residuals(model, numbers, part)[1], samples)


def _inertial(model: Model, robot: RobotModel, numbers: Numbers, now: Samples) -> tuple[Array, Array]:
    """Return what is unexplained in one sample, and the mass matrix, of a robot with its masses and axes as found.

    Both are over the mass's factor: noise would make everything small that multiplies it.
    """
    burnt = numbers.fuel * now.burnt / robot.masses.max()
    robot = replace(
        robot,
        masses=jnp.where(robot.masses == robot.masses.max(), 1.0 - burnt, 1.0) * robot.masses,
        inertias=jnp.where(robot.masses == robot.masses.max(), 1.0 - burnt, 1.0)[:, None, None] * robot.inertias,
    )
    rotation = now.rotation @ exp_so3(-numbers.imu)
    base_from_gyro = rotation @ exp_so3(-numbers.gyro)
    velocity = jnp.concatenate([now.linear_velocity, base_from_gyro @ now.gyro, now.joint_velocity])
    acceleration = jnp.concatenate([now.linear_acceleration, base_from_gyro @ now.gyro_rate, now.joint_acceleration])
    state = State(jnp.zeros(3), rotation, now.joint_position - numbers.encoders, velocity)
    kin = kinematics(robot, state)
    dyn = dynamics(robot, state, kin)
    links = link_forces(model.aero, robot, kin, LinkConventions(), now.wind + numbers.wind)
    carriers = kin.body_rotations[np.array(robot.aero_links.bodies, dtype=int)]
    turned = links.forces + cross(rotate(carriers, numbers.air_turn), links.forces)
    links = links._replace(forces=(1.0 + numbers.air)[:, None] * turned)
    air = generalised_aero_force(robot, kin, links, links.arm_points + rotate(carriers, numbers.air_point))
    measured = now.thrust - numbers.delay[0] * now.thrust_rate - numbers.thrust_offset
    thrust = generalised_thrust(robot, kin, (1.0 + numbers.thrust_gain) * measured)
    slipping = now.joint_velocity / jnp.sqrt(now.joint_velocity**2 + SLIP**2)
    drive = (1.0 + of_joints(robot, numbers.torque_gain)) * (now.torque - numbers.delay[1] * now.torque_rate)
    drive = drive - numbers.friction * slipping - numbers.damping * now.joint_velocity
    acting = thrust + air + now.feet + jnp.concatenate([numbers.wrench, drive])
    factor = 1.0 + numbers.mass
    return (dyn.mass_matrix @ acceleration + dyn.bias - acting) / factor, dyn.mass_matrix / factor


def of_joints(robot: RobotModel, groups: Float[Array, " g"]) -> Float[Array, " n"]:
    """Return the numbers of the groups for each of their joints."""
    by_joint = jnp.zeros(robot.n_joints)
    for place, (_, joints) in enumerate(robot.joint_groups):
        by_joint = by_joint.at[np.array(joints, dtype=int)].set(groups[place])
    return by_joint


def scale_of(robot: RobotModel) -> tuple[float, float]:
    """Return weight [N] and radius of gyration about the base [m] of a robot with straight joints."""
    still = State(jnp.zeros(3), jnp.eye(3), jnp.zeros(robot.n_joints), jnp.zeros(robot.n_velocities))
    inertia = np.asarray(dynamics(robot, still, kinematics(robot, still)).mass_matrix)
    return float(inertia[0, 0] * robot.gravity), float(np.sqrt(np.trace(inertia[3:6, 3:6]) / (2.0 * inertia[0, 0])))


def unmodelled_variance(
    robot: RobotModel,
    air: Float[np.ndarray, "f N"],
    unmodelled: tuple[float, float, float] = UNMODELLED,
) -> Float[np.ndarray, "f N"]:
    """Return the mean square of every row that no number explains, where the air acts with these forces."""
    weight, radius = scale_of(robot)
    white = np.repeat(weight * np.array([1.0, radius, radius]) * unmodelled, [3, 3, robot.n_joints])
    of_air = AIR[0] ** 2 * np.abs(air) ** 2
    of_air[:, :3] = of_air[:, :3].sum(axis=1, keepdims=True)  # lift too, which drag alone lacks
    of_air[:, 3:] += (radius * np.repeat(AIR[1:], [3, robot.n_joints])) ** 2 * of_air[:, :1]
    return np.asarray(white**2 + of_air)


def slopes_of(model: Model, numbers: Numbers, samples: Samples, chosen: tuple[int, ...]) -> Float[np.ndarray, "k N p"]:
    """Return the derivatives of what is unexplained with respect to the chosen numbers."""
    by_parts = np.asarray(_by_numbers(model, numbers))[:, list(chosen)]
    slopes = _by_chunks(lambda part: _derivatives(model, numbers, part), samples)
    return np.asarray(slopes[..., : len(by_parts)] @ by_parts + slopes[..., len(by_parts) :][..., list(chosen)])


def _by_chunks(function: Callable[[Samples], Array], samples: Samples) -> np.ndarray:
    """Return a function of samples, which is compiled for `CHUNK` of them only."""
    count = len(samples.weight)
    places = np.minimum(np.arange(max(-(-count // CHUNK), 1) * CHUNK), count - 1)
    rows = [np.asarray(part)[places] for part in samples]
    parts = [
        np.asarray(function(Samples(*(part[place : place + CHUNK] for part in rows))))
        for place in range(0, len(places), CHUNK)
    ]
    joined: np.ndarray = np.concatenate(parts)[:count]
    return joined


@jax.jit
def _residuals(model: Model, numbers: Numbers, samples: Samples) -> tuple[Array, Array]:
    robot = robot_with(model, numbers)
    return jax.vmap(lambda now: _inertial(model, robot, numbers, now))(samples)


def _parts(robot: RobotModel) -> tuple[Array, Array, Array, Array]:
    """Return what of a robot depends on numbers."""
    return robot.masses, robot.coms, robot.inertias, robot.jets.axes


@jax.jit
def _by_numbers(model: Model, numbers: Numbers) -> Float[Array, "e p"]:
    """Return the derivatives of the robot's parts by all numbers."""
    whole, unravel = ravel_pytree(numbers)
    derivatives: Array = jax.jacfwd(lambda theta: ravel_pytree(_parts(robot_with(model, unravel(theta))))[0])(whole)
    return derivatives


@jax.jit
def _of_mass(model: Model, numbers: Numbers, now: Samples) -> Float[Array, "N 6 p"]:
    whole, unravel = ravel_pytree(numbers)

    def columns(theta: Array) -> Array:
        guess = unravel(theta)
        first: Array = _inertial(model, robot_with(model, guess), guess, now)[1][:, :6]
        return first

    by: Array = jax.jacfwd(columns)(whole)
    return columns(whole)[..., None] * by


def mass_slopes(
    model: Model, numbers: Numbers, samples: Samples, chosen: tuple[int, ...]
) -> Float[np.ndarray, "N 6 p"]:
    """Return the derivatives of half of the squares of the mass matrix's first columns, in the middle of a log."""
    middle = Samples(*(jnp.asarray(part[len(part) // 2]) for part in samples))
    return np.asarray(_of_mass(model, numbers, middle))[..., list(chosen)]


@jax.jit
def _derivatives(model: Model, numbers: Numbers, samples: Samples) -> Float[Array, "k N q"]:
    """Return the derivatives of the residual by the robot's parts, then by the numbers themselves."""
    robot = robot_with(model, numbers)
    parts, of_parts = ravel_pytree(_parts(robot))
    whole, of_numbers = ravel_pytree(numbers)

    def one(now: Samples) -> Any:
        def of(both: Array) -> Array:
            masses, coms, inertias, axes = of_parts(both[: parts.size])
            jets = replace(robot.jets, axes=axes)
            other = replace(robot, masses=masses, coms=coms, inertias=inertias, jets=jets)
            return _inertial(model, other, of_numbers(both[parts.size :]), now)[0]

        return jax.jacrev(of)(jnp.concatenate([parts, whole]))

    derivatives: Array = jax.vmap(one)(samples)
    return derivatives
