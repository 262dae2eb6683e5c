"""Numbers of a robot from its logs: maximum a posteriori over the equations of motion, in the frequency domain.

    r(t, θ) = M ν̇ + h − Sτ + friction − Σ Jᵀ g T a − air        what acts on the robot unexplained, all 6 + n rows
    minimise  Σ_f |r̂(f, θ)|² / S(f) + ½ |θ/σ|²                   r̂ the transform of the tapered r, S its spectrum

`θ` are differences from the robot's file, `σ` their prior deviations. Derivatives of the residual are JAX's; `S`, the
noise of each row, is estimated with `θ` in bands of frequency, which share the degrees of freedom that `θ` takes.

Source: equation-error method in the frequency domain; Klein and Morelli, *Aircraft System Identification*, 2nd ed.,
chapter 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from jax_aero.body.spatial import exp_so3
from jax_aero.types import Array, State

SLIP = 0.03
"""Velocity from which dry friction is taken as most of the whole [rad/s]: a joint that trembles feels less of it."""
MOVING = 0.15
"""Velocity above which a joint does not stick [rad/s]; between it and `SLIP` friction depends on how it trembles."""
FREQUENCY = 2.0
"""Highest frequency of the residual that is used [Hz]: above it sensors and drives are noise."""
BAND = 12
"""Frequencies in which a row's noise is taken as white."""
TAPER = 0.1
"""Share of a log at its ends over which the residual rises and falls."""
COARSE, WEIGHED = 4, 5
"""The residual, nearly linear, is linearised in every fourth sample, then in all; how often its noise is estimated."""
UNMODELLED = (7e-4, 4.3e-4, 8.5e-4)
"""Deviation, in every sample, of forces and moments on the base and of torques that no number explains, as shares of
the weight and of the weight at the radius of gyration. Ours: of drawn robots' residuals at their truth."""
COHERENT = 2.2e-4
"""Deviation of the whole robot's centre of mass that such air imitates [m], since it moves with the robot; ours, of
drawn robots, whose base seems 3 mm higher in a network's air than in the controller's own."""
AIR = (0.3, 0.4)
"""Share of the air's force in every frequency that no factor of a link explains, and its lever arm over the radius of
gyration: what an analytical model leaves of a network."""
CHUNK = 50
"""Samples whose derivatives are computed at once; bounds the memory."""


class Numbers(NamedTuple):
    """Numbers of a robot that a log may determine; zero is what its file states."""

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
    air: Float[Any, " l"]
    """Of the force of the air on each link, relative."""
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
    position_rate: Float[Any, "k 3"]
    """Derivative of the measured position of the base [m/s]."""
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
    torque: Float[Any, "k n"]
    torque_rate: Float[Any, "k n"]
    wind: Float[Any, "k 3"]
    feet: Float[Any, "k N"]
    """Generalised forces of the measured wrenches of the feet; zero in flight."""


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
    held_out
        Of every log that was held out: what the numbers of the others leave, its deviation by what is unknown of them,
        and the weights of the rows, each (k, 6 + n).
    """

    value: Float[np.ndarray, " p"]
    deviation: Float[np.ndarray, " p"]
    prior: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    residuals: list[tuple[np.ndarray, np.ndarray]]
    held_out: list[tuple[np.ndarray, np.ndarray, np.ndarray]]

    @property
    def share(self) -> Float[np.ndarray, " p"]:
        """Share of the data in what is known: 0 for the prior alone, 1 where the prior does not matter."""
        share: np.ndarray = 1.0 - (self.deviation / np.where(self.prior > 0.0, self.prior, 1.0)) ** 2
        return share

    def undetermined(self, count: int = 3) -> list[tuple[float, np.ndarray]]:
        """Return the directions, in units of the prior, that the data determine least, and their share of the prior."""
        scale = np.where(self.prior > 0.0, self.prior, 1.0)
        shares, directions = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return [(float(shares[-k]), directions[:, -k]) for k in range(1, count + 1)]


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


def unexplained(robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples) -> Float[np.ndarray, "k N"]:
    """Return what acts on the robot unexplained in every sample: on the base about its origin, and on the joints."""
    return _by_chunks(lambda part: _residuals(robot, aero, numbers, part)[0], samples)


def air_of(
    robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples, left: Float[np.ndarray, "k N"]
) -> Float[np.ndarray, "k N"]:
    """Return the forces of the air, without which so much more than `left` is unexplained."""
    without = numbers._replace(air=-jnp.ones_like(jnp.asarray(numbers.air)))
    air: np.ndarray = unexplained(robot, aero, without, samples) - left
    return air


def mass_matrices(robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples) -> Float[np.ndarray, "k N N"]:
    """Return the mass matrix of every sample."""
    return _by_chunks(lambda part: _residuals(robot, aero, numbers, part)[1], samples)


def _inertial(robot: RobotModel, aero: AeroModel, numbers: Numbers, now: Samples) -> tuple[Array, Array]:
    """Return what is unexplained in one sample, and the mass matrix."""
    robot = robot_with(robot, numbers)
    rotation = now.rotation @ exp_so3(-numbers.imu)
    velocity = jnp.concatenate([now.linear_velocity, rotation @ now.gyro, now.joint_velocity])
    acceleration = jnp.concatenate([now.linear_acceleration, rotation @ now.gyro_rate, now.joint_acceleration])
    state = State(jnp.zeros(3), rotation, now.joint_position - numbers.encoders, velocity)
    kin = kinematics(robot, state)
    dyn = dynamics(robot, state, kin)
    links = link_forces(aero, robot, kin, LinkConventions(), now.wind + numbers.wind)
    links = links._replace(forces=(1.0 + numbers.air)[:, None] * links.forces)
    air = generalised_aero_force(robot, kin, links, links.arm_points)
    measured = now.thrust - numbers.delay[0] * now.thrust_rate - numbers.thrust_offset
    thrust = generalised_thrust(robot, kin, (1.0 + numbers.thrust_gain) * measured)
    slipping = now.joint_velocity / jnp.sqrt(now.joint_velocity**2 + SLIP**2)
    drive = now.torque - numbers.delay[1] * now.torque_rate
    drive = drive - numbers.friction * slipping - numbers.damping * now.joint_velocity
    acting = thrust + air + now.feet + jnp.concatenate([numbers.wrench, drive])
    return dyn.mass_matrix @ acceleration + dyn.bias - acting, dyn.mass_matrix


def scale_of(robot: RobotModel) -> tuple[float, float]:
    """Return weight [N] and radius of gyration about the base [m] of a robot with straight joints."""
    still = State(jnp.zeros(3), jnp.eye(3), jnp.zeros(robot.n_joints), jnp.zeros(robot.n_velocities))
    inertia = np.asarray(dynamics(robot, still, kinematics(robot, still)).mass_matrix)
    return float(inertia[0, 0] * robot.gravity), float(np.sqrt(np.trace(inertia[3:6, 3:6]) / (2.0 * inertia[0, 0])))


def unmodelled_variance(
    robot: RobotModel, air: Float[np.ndarray, "f N"], unmodelled: tuple[float, float, float] = UNMODELLED
) -> Float[np.ndarray, "f N"]:
    """Return the mean square of every row that no number explains, where the air acts with these forces."""
    weight, radius = scale_of(robot)
    white = np.repeat(weight * np.array([1.0, radius, radius]) * unmodelled, [3, 3, robot.n_joints])
    of_air = np.abs(air) ** 2
    of_air[:, 3:6] += (AIR[1] * radius) ** 2 * of_air[:, :3].sum(axis=1, keepdims=True)
    return np.asarray(white**2 + AIR[0] ** 2 * of_air)


def estimate(
    robot: RobotModel,
    aero: AeroModel,
    logs: Sequence[Samples],
    period: float,
    prior: Numbers,
    weighed: tuple[float, float] | None = None,
    unmodelled: tuple[float, float, float] = UNMODELLED,
    known: Sequence[int] | None = None,
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
    known
        Number of the first samples of every log that predict the others; the numbers are then those of all.
    """
    widths, unravel = ravel_pytree(prior)
    width: np.ndarray = np.asarray(widths, dtype=float)
    free = np.flatnonzero(width > 0.0)
    sigma = width[free]
    chosen = tuple(free.tolist())
    counts = [len(one.weight) for one in logs]
    known = counts if known is None else known
    theta = np.zeros(width.size)
    before = [unexplained(robot, aero, unravel(jnp.asarray(theta)), one) for one in logs]
    rows = [_moving(one) for one in logs]

    def solve(start: Any, linear: Any, counts: Sequence[int], step: int = 1) -> tuple[Any, Any]:
        """Return numbers and their covariance in units of the prior, from the first samples of every log."""
        spectra = []
        for (left, slopes, air), weights, count in zip(linear, rows, counts, strict=True):
            if count:
                window, end = weights[:count:step], -(-count // step)
                left, by, of_air = _transformed(window, left[:end], slopes[:end], air[:end], step * period)
                spectra.append((left, by, unmodelled_variance(robot, of_air, unmodelled)))
        theta = start.copy()
        covariance: np.ndarray = np.zeros((sigma.size, sigma.size))
        for _ in range(WEIGHED):
            information, slope = np.eye(sigma.size), -theta[free] / sigma
            if weighed is not None and width[0] > 0.0:
                mass = float(np.sum(robot.masses))
                by_mass = sigma[0] * mass / weighed[1]
                information[0, 0] += by_mass**2
                slope[0] += by_mass * (weighed[0] - mass * (1.0 + theta[0])) / weighed[1]
            for left, by, variance in spectra:
                added = _information(left + by @ (theta - start)[free], sigma * by, variance, covariance)
                information, slope = information + added[0], slope - added[1]
            covariance = np.linalg.inv(information)
            theta[free] += sigma * (covariance @ slope)
        return theta, covariance

    def linear(theta: Any, counts: Sequence[int], step: int = 1) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        guess, found = unravel(jnp.asarray(theta)), []
        for one, count in zip(logs, counts, strict=True):
            part = Samples(*(rows[: max(count, 1) : step] for rows in one))
            left = unexplained(robot, aero, guess, part)
            found.append((left, _slopes(robot, aero, guess, part, chosen), air_of(robot, aero, guess, part, left)))
        return found

    theta, _ = solve(theta, linear(theta, known, COARSE), known, COARSE)
    start, whole = theta, linear(theta, counts)
    theta, covariance = solve(start, whole, known)
    held_out = []
    for (left, slopes, _), weights, count in zip(whole, rows, known, strict=True):
        by = sigma * slopes[count:]
        spread = np.sqrt(np.sum(by * (by @ covariance), axis=-1))
        held_out.append((left[count:] + slopes[count:] @ (theta - start)[free], spread, weights[count:]))
    theta, covariance = solve(start, whole, counts)
    after = [left + slopes @ (theta - start)[free] for left, slopes, _ in whole]
    full = np.zeros((width.size, width.size))
    full[np.ix_(free, free)] = covariance * np.outer(sigma, sigma)
    of_air = unravel(jnp.zeros(width.size))._replace(com=jnp.full(3, COHERENT * np.sum(robot.masses) / robot.masses[0]))
    full += np.diag(np.where(width > 0.0, ravel_pytree(of_air)[0], 0.0) ** 2)
    return Found(theta, np.sqrt(np.diag(full)), width, full, list(zip(before, after, strict=True)), held_out)


def expected(
    robot: RobotModel, aero: AeroModel, numbers: Numbers, found: Found, log: Samples, period: float
) -> Float[np.ndarray, " p"]:
    """Return the standard deviations after one more log, of which the motion alone counts (p,).

    `numbers` are about the values of `found`. The noise is white and as large as what these leave of their last log.
    """
    free = np.flatnonzero(found.prior > 0.0)
    sigma = found.prior[free]
    slopes, left = _slopes(robot, aero, numbers, log, tuple(free.tolist())), unexplained(robot, aero, numbers, log)
    _, by, air = _transformed(_moving(log), left, slopes, air_of(robot, aero, numbers, log, left), period)
    noise = np.broadcast_to(np.std(found.residuals[-1][1], axis=0), by.shape[:2])
    added, _ = _information(noise, sigma * by, unmodelled_variance(robot, air), np.zeros((free.size, free.size)))
    known = np.linalg.inv(found.covariance[np.ix_(free, free)] / np.outer(sigma, sigma))
    after = np.zeros(found.prior.size)
    after[free] = sigma * np.sqrt(np.diag(np.linalg.inv(known + added)))
    return after


def _slopes(
    robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples, chosen: tuple[int, ...]
) -> Float[np.ndarray, "k N p"]:
    """Return the derivatives of what is unexplained with respect to the chosen numbers."""
    return _by_chunks(lambda part: _derivatives(robot, aero, numbers, part, chosen), samples)


def _by_chunks(function: Callable[[Samples], Array], samples: Samples) -> np.ndarray:
    """Return a function of samples, which is compiled for `CHUNK` of them only."""
    count = len(samples.weight)
    places = np.minimum(np.arange(max(-(-count // CHUNK), 1) * CHUNK), count - 1)
    rows = [np.asarray(part)[places] for part in samples]
    parts = [
        np.asarray(function(Samples(*(part[place : place + CHUNK] for part in rows))))
        for place in range(0, len(places), CHUNK)
    ]
    found: np.ndarray = np.concatenate(parts)[:count]
    return found


@jax.jit
def _residuals(robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples) -> tuple[Array, Array]:
    return jax.vmap(lambda now: _inertial(robot, aero, numbers, now))(samples)


@partial(jax.jit, static_argnames="chosen")
def _derivatives(
    robot: RobotModel, aero: AeroModel, numbers: Numbers, samples: Samples, chosen: tuple[int, ...]
) -> Float[Array, "k N p"]:
    whole, unravel = ravel_pytree(numbers)
    places = np.array(chosen)

    def one(now: Samples) -> Any:
        def of(part: Array) -> Array:
            return _inertial(robot, aero, unravel(whole.at[places].set(part)), now)[0]

        return jax.jacfwd(of)(whole[places])

    found: Array = jax.vmap(one)(samples)
    return found


def _moving(samples: Samples) -> Float[np.ndarray, "k N"]:
    """Return weights of the rows: none in samples that are not covered, and little for a joint that may stick.

    It holds any torque up to its friction.
    """
    speed = np.abs(np.asarray(samples.joint_velocity)) / MOVING
    weight = np.where(speed > 0.7, speed**4 / (1.0 + speed**4), 0.0)
    of_rows: np.ndarray = np.concatenate([np.ones((len(weight), 6)), weight], axis=1)
    of_rows *= np.asarray(samples.weight)[:, None]
    return of_rows


def _transformed(
    weights: Float[np.ndarray, "k N"],
    left: Float[np.ndarray, "k N"],
    slopes: Float[np.ndarray, "k N p"],
    air: Float[np.ndarray, "k N"],
    period: float,
) -> tuple[Complex[np.ndarray, "f N"], Complex[np.ndarray, "f N p"], Complex[np.ndarray, "f N"]]:
    """Return the transforms of a residual, its derivatives and the air, such that white noise keeps its variance."""
    count = len(left)
    taper, size = _taper(count), int(min(FREQUENCY, 0.4 / period) * count * period) + 1
    window = (taper / np.sqrt(np.sum(taper**2)))[:, None] * weights
    parts = (window * left, window[:, :, None] * slopes, window * air)
    of_left, by, of_air = (np.fft.rfft(part, axis=0)[:size] for part in parts)
    return of_left, by, of_air


def _information(
    left: Complex[np.ndarray, "f N"],
    by: Complex[np.ndarray, "f N p"],
    variance: Float[np.ndarray, "f N"],
    covariance: Float[np.ndarray, "p p"],
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
    """Return information and slope of one log's likelihood.

    In every band the spectrum is the mean of `variance` and the mean square of what is left, over the degrees of
    freedom that `covariance` leaves.
    """
    size = len(left)
    double = np.where(np.arange(size) == 0, 1.0, 2.0)  # a real and an imaginary part
    information, slope = np.zeros((by.shape[2],) * 2), np.zeros(by.shape[2])
    for band in np.array_split(np.arange(size), max(size // BAND, 1)):
        weight = double[band, None]
        power = np.sum(weight * np.abs(left[band]) ** 2, axis=0)
        slopes = by[band]
        freedom = np.full(power.size, weight.sum())
        taking = np.sum(weight[:, :, None] * (slopes.conj() * (slopes @ covariance)).real, axis=(0, 2))
        least = np.sum(weight * variance[band], axis=0) / weight.sum()
        spectrum = power / freedom + least
        for _ in range(3):
            taken = taking / spectrum
            spectrum = power / np.maximum(freedom - taken, 0.25 * freedom) + least
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
