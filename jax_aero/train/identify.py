"""Numbers of a robot from its logs: maximum a posteriori over the equations of motion, in the frequency domain.

    r(t, θ) = M ν̇ + h − Sτ + friction − Σ Jᵀ g T a − air        what acts on the robot unexplained, all 6 + n rows
    minimise  Σ_f |r̂(f, θ)|² / S(f) + ½ |θ/σ|²                   r̂ the transform of the tapered r, S its spectrum

`θ` are differences from the robot's file, `σ` their prior deviations. Derivatives of the residual are JAX's; `S`, the
noise of each row, is estimated with `θ` in bands of frequency, which share the degrees of freedom that `θ` takes.

Source: equation-error method in the frequency domain; Klein and Morelli, *Aircraft System Identification*, 2nd ed.,
chapter 7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float

from jax_aero.aero import AeroModel, LinkConventions, generalised_aero_force, link_forces
from jax_aero.body.dynamics import dynamics
from jax_aero.body.kinematics import generalised_thrust, kinematics
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import exp_so3, rotation_from_wxyz
from jax_aero.types import Array, State

SLIP = 0.02
"""Velocity from which dry friction is taken as whole [rad/s]: what smoothed encoders resolve."""
MOVING = 0.05
"""Velocity above which a joint does not stick [rad/s]."""
FREQUENCY = 3.0
"""Highest frequency of the residual that is used [Hz]: above it sensors and drives are noise."""
BAND = 12
"""Frequencies in which a row's noise is taken as white."""
TAPER = 0.1
"""Share of a log at its ends over which the residual rises and falls."""
LINEARISED, WEIGHED = 2, 5
"""How often the residual is linearised, and its noise estimated for each: the residual is nearly linear."""
UNMODELLED = (1.4, 0.3, 0.7)
"""Deviation, in every sample, of forces and moments on the base and of torques that no number explains [N, N m, N m].

Ours: with smaller ones the intervals of drawn robots do not hold the truth, since friction that sticks, air that no
model fits and lags of some milliseconds are no white noise.
"""
CHUNK = 50
"""Samples whose derivatives are computed at once; bounds the memory."""


class Numbers(NamedTuple):
    """What a log may tell of a robot; zero is what its file states."""

    mass: Float[Any, ""]
    """Of all masses and inertias, relative."""
    com: Float[Any, "3"]
    """Offset of the base body's centre of mass [m]."""
    inertia: Float[Any, ""]
    """Of all inertias beside that of the masses, relative."""
    thrust_gain: Float[Any, " j"]
    """Of the force of each jet over its thrust, relative."""
    thrust_offset: Float[Any, " j"]
    """Offset of the measured thrusts [N]."""
    thrust_axes: Float[Any, "j 2"]
    """Tilt of each jet about two axes across its thrust, of which `across` gives the directions [rad]."""
    imu: Float[Any, "3"]
    """Rotation of the measured base from the true one, base axes [rad]."""
    encoders: Float[Any, " n"]
    """Offset of the measured joint positions [rad, m]."""
    friction: Float[Any, " n"]
    """Dry friction of each drive [N m, N]."""
    damping: Float[Any, ""]
    """Viscous friction of all drives [N m s]."""
    air: Float[Any, ""]
    """Of all forces of the air, relative."""
    wrench: Float[Any, "6"]
    """Constant force and moment on the base that nothing else explains [N, N m]."""


class Samples(NamedTuple):
    """Smoothed measurements of one log at k times, all of the same moment."""

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
    torque: Float[Any, "k n"]
    wind: Float[Any, "k 3"]


class Found(NamedTuple):
    """Most probable numbers, their covariance, and what they leave unexplained.

    Attributes
    ----------
    value, deviation, prior
        Most probable differences, their standard deviations, and those before (p,).
    covariance
        (p, p).
    residuals
        Of every log before and after (k, 6 + n) [N, N m].
    """

    value: Float[np.ndarray, " p"]
    deviation: Float[np.ndarray, " p"]
    prior: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    residuals: list[tuple[np.ndarray, np.ndarray]]

    @property
    def share(self) -> Float[np.ndarray, " p"]:
        """Share of the data in what is known: 0 for the prior alone, 1 where the prior does not matter."""
        share: np.ndarray = 1.0 - (self.deviation / np.where(self.prior > 0.0, self.prior, 1.0)) ** 2
        return share

    def unlearned(self, count: int = 3) -> list[tuple[float, np.ndarray]]:
        """Return the directions, in units of the prior, that the data determine least, and their share of the prior."""
        scale = np.where(self.prior > 0.0, self.prior, 1.0)
        shares, directions = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return [(float(shares[-k]), directions[:, -k]) for k in range(1, count + 1)]


def states_of(log: Mapping[str, Float[np.ndarray, "ticks ..."]], ticks: Any) -> State:
    """Return the states of a log at the given ticks."""
    velocity = np.concatenate([log["base_velocity"][ticks], log["joint_velocity"][ticks]], axis=1)
    return State(
        base_position=jnp.asarray(log["base_position"][ticks]),
        base_rotation=rotation_from_wxyz(jnp.asarray(log["base_quaternion"][ticks])),
        joint_position=jnp.asarray(log["joint_position"][ticks]),
        velocity=jnp.asarray(velocity),
    )


def across(axis: Float[Array, "3"]) -> Float[Array, "3 2"]:
    """Return two orthogonal directions across an axis: the frame's own where the axis is one of them."""
    first = jnp.roll(jnp.eye(3), -1, axis=0)[jnp.abs(axis).argmax()]
    first = first - axis * (axis @ first)
    first = first / jnp.linalg.norm(first)
    return jnp.stack([first, jnp.cross(axis, first)], axis=1)


def robot_with(robot: RobotModel, numbers: Numbers) -> RobotModel:
    """Return the robot with these differences of masses, centre of mass, inertias and thrust axes."""
    axes = jax.vmap(lambda axis, tilt: exp_so3(across(axis) @ tilt) @ axis)(
        jnp.asarray(robot.jets.axes), jnp.asarray(numbers.thrust_axes)
    )
    return replace(
        robot,
        masses=robot.masses * (1.0 + numbers.mass),
        inertias=robot.inertias * (1.0 + numbers.mass) * (1.0 + numbers.inertia),
        coms=jnp.asarray(robot.coms).at[0].add(numbers.com),
        jets=replace(robot.jets, axes=axes),
    )


def unexplained(robot: RobotModel, aero: AeroModel, numbers: Numbers, now: Samples) -> Float[Array, " N"]:
    """Return what acts on the robot unexplained in one sample: on the base about its origin, and on the joints."""
    return _inertial(robot, aero, numbers, now)[0]


def base_error(robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples) -> Float[Array, "k 6"]:
    """Return measured less predicted accelerations of the base, the joints moving as measured [m/s², rad/s²]."""

    def one(now: Samples) -> Any:
        residual, mass = _inertial(robot, aero, numbers, now)
        return jnp.linalg.solve(mass[:6, :6], residual[:6])

    found: Array = jax.jit(lambda every: jax.lax.map(one, every, batch_size=CHUNK))(samples)
    return found


def _inertial(robot: RobotModel, aero: AeroModel, numbers: Numbers, now: Samples) -> tuple[Array, Array]:
    """Return what is unexplained in one sample, and the mass matrix."""
    robot = robot_with(robot, numbers)
    rotation = now.rotation @ exp_so3(-numbers.imu)
    velocity = jnp.concatenate([now.linear_velocity, rotation @ now.gyro, now.joint_velocity])
    acceleration = jnp.concatenate([now.linear_acceleration, rotation @ now.gyro_rate, now.joint_acceleration])
    state = State(jnp.zeros(3), rotation, now.joint_position - numbers.encoders, velocity)
    kin = kinematics(robot, state)
    dyn = dynamics(robot, state, kin)
    links = link_forces(aero, robot, kin, LinkConventions(), now.wind)
    air = generalised_aero_force(robot, kin, links, links.arm_points)
    thrust = generalised_thrust(robot, kin, (1.0 + numbers.thrust_gain) * (now.thrust - numbers.thrust_offset))
    drive = now.torque - numbers.friction * jnp.tanh(now.joint_velocity / SLIP) - numbers.damping * now.joint_velocity
    acting = thrust + (1.0 + numbers.air) * air + jnp.concatenate([numbers.wrench, drive])
    return dyn.mass_matrix @ acceleration + dyn.bias - acting, dyn.mass_matrix


def estimate(
    robot: RobotModel,
    aero: AeroModel,
    logs: Sequence[Samples],
    period: float,
    prior: Numbers,
    weighed: tuple[float, float] | None = None,
    unmodelled: tuple[float, float, float] = UNMODELLED,
) -> Found:
    """Return the most probable numbers.

    Parameters
    ----------
    logs
        Samples of every log, `period` apart [s].
    prior
        Standard deviations of the differences; a number with zero is taken as the file states it.
    weighed
        Mass of the robot on a scale, and its standard deviation [kg].
    unmodelled
        As `UNMODELLED`.
    """
    floor = np.repeat(unmodelled, [3, 3, robot.n_joints])
    widths, unravel = ravel_pytree(prior)
    width: np.ndarray = np.asarray(widths, dtype=float)
    free = np.flatnonzero(width > 0.0)
    sigma = width[free]
    chosen = tuple(free.tolist())
    theta = np.zeros(width.size)
    before = [np.asarray(_unexplained(robot, aero, unravel(jnp.asarray(theta)), one)) for one in logs]
    covariance: np.ndarray = np.zeros((sigma.size, sigma.size))
    for _ in range(LINEARISED):
        start = theta.copy()
        guess = unravel(jnp.asarray(theta))
        spectra = [
            _transformed(
                moving[:, :, None] * np.asarray(_slopes(robot, aero, guess, one, chosen)),
                moving * np.asarray(_unexplained(robot, aero, guess, one)),
                period,
            )
            for one, moving in zip(logs, map(_moving, logs), strict=True)
        ]
        for _ in range(WEIGHED):
            # In units of the prior deviations.
            information, slope = np.eye(sigma.size), -theta[free] / sigma
            if weighed is not None and width[0] > 0.0:
                mass = float(np.sum(robot.masses))
                by_mass = sigma[0] * mass / weighed[1]
                information[0, 0] += by_mass**2
                slope[0] += by_mass * (weighed[0] - mass * (1.0 + theta[0])) / weighed[1]
            for left, by in spectra:
                added = _information(left + by @ (theta - start)[free], sigma * by, floor, covariance)
                information, slope = information + added[0], slope - added[1]
            covariance = np.linalg.inv(information)
            theta[free] += sigma * (covariance @ slope)
    after = [np.asarray(_unexplained(robot, aero, unravel(jnp.asarray(theta)), one)) for one in logs]
    whole = np.zeros((width.size, width.size))
    whole[np.ix_(free, free)] = covariance * np.outer(sigma, sigma)
    return Found(theta, np.sqrt(np.diag(whole)), width, whole, list(zip(before, after, strict=True)))


def expected(
    robot: RobotModel, aero: AeroModel, numbers: Numbers, found: Found, log: Samples, period: float
) -> Float[np.ndarray, " p"]:
    """Return the standard deviations after one more log, of which the motion alone counts (p,).

    `numbers` are about the values of `found`. The noise is white and as large as what these leave of their last log.
    """
    free = np.flatnonzero(found.prior > 0.0)
    sigma = found.prior[free]
    slopes = np.asarray(_slopes(robot, aero, numbers, log, tuple(free.tolist())))
    moving = _moving(log)
    _, by = _transformed(moving[:, :, None] * slopes, moving, period)
    noise = np.broadcast_to(np.std(found.residuals[-1][1], axis=0), by.shape[:2])
    floor = np.repeat(UNMODELLED, [3, 3, robot.n_joints])
    added, _ = _information(noise, sigma * by, floor, np.zeros((free.size, free.size)))
    known = np.linalg.inv(found.covariance[np.ix_(free, free)] / np.outer(sigma, sigma))
    left = np.zeros(found.prior.size)
    left[free] = sigma * np.sqrt(np.diag(np.linalg.inv(known + added)))
    return left


@jax.jit
def _unexplained(robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples) -> Float[Array, "k N"]:
    found: Array = jax.lax.map(lambda now: unexplained(robot, aero, numbers, now), samples, batch_size=CHUNK)
    return found


@partial(jax.jit, static_argnames="chosen")
def _slopes(
    robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples, chosen: tuple[int, ...]
) -> Float[Array, "k N p"]:
    """Return the derivatives of what is unexplained with respect to the chosen numbers."""
    whole, unravel = ravel_pytree(numbers)
    places = np.array(chosen)

    def one(now: Samples) -> Any:
        def of(part: Array) -> Array:
            return unexplained(robot, aero, unravel(whole.at[places].set(part)), now)

        return jax.jacfwd(of)(whole[places])

    found: Array = jax.lax.map(one, samples, batch_size=CHUNK)
    return found


def _moving(samples: Samples) -> Float[np.ndarray, "k N"]:
    """Return weights of the rows: a joint that may stick holds any torque up to its friction, and tells nothing."""
    speed = np.abs(np.asarray(samples.joint_velocity)) / MOVING
    weight = np.where(speed > 0.7, speed**4 / (1.0 + speed**4), 0.0)
    return np.concatenate([np.ones((len(weight), 6)), weight], axis=1)


def _transformed(
    jacobian: Float[np.ndarray, "k N p"], residual: Float[np.ndarray, "k N"], period: float
) -> tuple[Complex[np.ndarray, "f N"], Complex[np.ndarray, "f N p"]]:
    """Return the transforms of a tapered residual and of its derivatives, such that white noise keeps its variance."""
    count = len(residual)
    taper = _taper(count)
    size = int(min(FREQUENCY, 0.4 / period) * count * period) + 1
    norm = np.sqrt(np.sum(taper**2))
    left = np.fft.rfft(taper[:, None] * residual, axis=0)[:size] / norm
    return left, np.fft.rfft(taper[:, None, None] * jacobian, axis=0)[:size] / norm


def _information(
    left: Complex[np.ndarray, "f N"],
    by: Complex[np.ndarray, "f N p"],
    floor: Float[np.ndarray, " N"],
    covariance: Float[np.ndarray, "p p"],
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
    """Return information and slope of one log's likelihood.

    In every band the spectrum is `floor`² and the mean square of what is left, over the degrees of freedom that
    `covariance` leaves.
    """
    size = len(left)
    double = np.where(np.arange(size) == 0, 1.0, 2.0)  # a real and an imaginary part
    information, slope = np.zeros((by.shape[2],) * 2), np.zeros(by.shape[2])
    for band in np.array_split(np.arange(size), max(size // BAND, 1)):
        weight = double[band, None]
        power = np.sum(weight * np.abs(left[band]) ** 2, axis=0)
        slopes = by[band]
        freedom = np.full(power.size, weight.sum())
        spectrum = power / freedom + floor**2
        for _ in range(3):
            taken = np.einsum("b,bNp,pq,bNq->N", weight[:, 0], slopes.conj(), covariance, slopes).real / spectrum
            spectrum = power / np.maximum(freedom - taken, 0.25 * freedom) + floor**2
        scale = np.sqrt(weight / spectrum)
        slopes = (scale[:, :, None] * slopes).reshape(-1, by.shape[2])
        information += (slopes.conj().T @ slopes).real
        slope += (slopes.conj().T @ (scale * left[band]).reshape(-1)).real
    return information, slope


def _taper(count: int) -> np.ndarray:
    """Return a window that rises and falls as a cosine at the ends."""
    edge = np.minimum(np.arange(count) + 0.5, count - np.arange(count) - 0.5) / (TAPER * count)
    window: np.ndarray = 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1.0))
    return window
