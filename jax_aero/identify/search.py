"""Numbers of a robot from its logs: maximum a posteriori over the equations of motion, in the frequency domain.

    minimise  Σ_f |r̂(f, θ)|² / S(f) + ½ θᵀ P⁻¹ θ       r̂ the transform of the tapered r of `motion`, S its spectrum

`θ` are differences from the robot's file, `P` their prior covariance, of deviations `σ`, in which gains of torques
alone are related. `S`, the noise of each row, is estimated with `θ` in bands of frequency, which share the degrees of
freedom that `θ` takes.

Noise of measurements that numbers multiply biases them, as it is least where they are small; its mean share of the
gradient, of thrusts in their gains and of the base's accelerations in the mass matrix M, is taken off:

    b_j = Σ_f σ²(f) / S(f) ∂/∂θ_j ½ |∂r/∂a|²                    a what has the noise, of spectrum σ²

Sources: equation-error method in the frequency domain; Klein and Morelli, *Aircraft System Identification*, 2nd ed.,
chapter 7. Noise: Söderström, *Errors-in-Variables Methods in System Identification*, 2018, chapter 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float

from jax_aero.base.terminal import progress_bar
from jax_aero.body.robot import RobotModel
from jax_aero.identify.motion import (
    UNMODELLED,
    WIDTH,
    Model,
    Numbers,
    Samples,
    air_of,
    mass_slopes,
    slopes_of,
    unexplained,
    unmodelled_variance,
)

MOVING = 0.15
"""Velocity above which a joint does not stick [rad/s]; between it and `SLIP` friction depends on how it trembles."""
FREQUENCY = 2.0
"""Highest frequency of the residual that is used [Hz]: above it sensors and drives are noise."""
BAND = 12
"""Frequencies in which a row's noise is taken as white."""
TAPER = 0.1
"""Share of a log at its ends over which the residual rises and falls."""
COARSE, WEIGHED = 4, 4
"""The search begins with every fourth sample; how often the noise is estimated in every linear problem."""
STEPS, LINEARISED, CONVERGED, STALLED = 16, 8, 0.05, 0.5
"""Most steps of the search and most linearisations, deviations by which the last step moves a number at most, and the
share of a step from which the next one is linearised anew."""
COHERENT, COHERENT_INERTIA = 2.2e-4, 0.015
"""Deviation of the whole robot's centre of mass [m], and of the factor of inertias, that such air imitates, since it
moves with the robot; ours, of drawn robots, whose base seems 3 mm higher in a network's air."""
LATE = 1e-3
"""Deviation of the delay of torques that jitter and held commands imitate [s]; ours, of drawn robots."""
ALIKE = 0.8
"""Correlation of the gains of torques before the logs, since a robot's drives are of one kind; ours."""


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
    moved
        Deviations by which the last step of the search moved a number.
    """

    value: Float[np.ndarray, " p"]
    deviation: Float[np.ndarray, " p"]
    prior: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    residuals: list[tuple[np.ndarray, np.ndarray]]
    held_out: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    moved: float = 0.0

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


def estimate(
    model: Model,
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
    problem = _Problem.of(model, logs, period, prior, weighed, unmodelled)
    counts = [len(one.weight) for one in logs]
    known = counts if known is None else known
    with progress_bar("step", delay=0) as show:
        start = np.zeros(problem.width.size)
        theta, *_ = problem.search(start, known, COARSE, lambda step: show(step, 2 * STEPS))
        theta, covariance, linear, moved = problem.search(theta, counts, 1, lambda step: show(STEPS + step, 2 * STEPS))
    held_out = problem.predict(theta, covariance, linear, known)
    residuals = list(zip(problem.left_of(0.0 * theta), problem.left_of(theta), strict=True))
    full = problem.whole(covariance)
    return Found(theta, np.sqrt(np.diag(full)), problem.width, full, residuals, held_out, moved)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The search for numbers by Gauss and Newton: linearise, solve in units of the prior, until steps are short.

    Numbers are a vector (p,), `theta`, of which the free ones, those with a prior, have covariances and slopes.
    """

    model: Model
    logs: Sequence[Samples]
    period: float
    """Time between samples [s]."""
    width: np.ndarray
    """Standard deviations of the prior (p,); zero for a number that is not searched."""
    before: np.ndarray
    """Inverse of the prior's covariance of the free numbers, in units of their deviations."""
    gains: np.ndarray
    offsets: np.ndarray
    """Places of the thrusts' gains and offsets among the free numbers; none unless all are free."""
    numbers_of: Callable[[Any], Numbers]
    """Function from a vector of numbers to them by name."""
    weighed: tuple[float, float] | None
    unmodelled: tuple[float, float, float]

    @classmethod
    def of(
        cls,
        model: Model,
        logs: Sequence[Samples],
        period: float,
        prior: Numbers,
        weighed: tuple[float, float] | None,
        unmodelled: tuple[float, float, float],
    ) -> _Problem:
        """Return the problem of these arguments of `estimate`."""
        widths, unravel = ravel_pytree(prior)
        width: np.ndarray = np.asarray(widths, dtype=float)
        free = np.flatnonzero(width > 0.0)
        index = unravel(jnp.arange(width.size, dtype=float))
        gains = offsets = np.zeros(0, dtype=int)
        thrusts = [np.asarray(part, dtype=int) for part in (index.thrust_gain, index.thrust_offset)]
        if np.all(np.isin(np.concatenate(thrusts), free)):
            gains, offsets = (np.searchsorted(free, part) for part in thrusts)
        before: np.ndarray = np.eye(free.size)
        of_torques = np.flatnonzero(np.isin(free, np.asarray(index.torque_gain, dtype=int)))
        before[np.ix_(of_torques, of_torques)] += ALIKE * (1.0 - np.eye(of_torques.size))
        before = np.linalg.inv(before)
        return cls(model, logs, period, width, before, gains, offsets, unravel, weighed, unmodelled)

    @cached_property
    def free(self) -> np.ndarray:
        """Places of the numbers that are searched."""
        return np.flatnonzero(self.width > 0.0)

    @cached_property
    def sigma(self) -> np.ndarray:
        """Their standard deviations before."""
        return np.asarray(self.width[self.free])

    @cached_property
    def chosen(self) -> tuple[int, ...]:
        """Their places, for functions that are compiled for them."""
        return tuple(self.free.tolist())

    @cached_property
    def rows(self) -> list[np.ndarray]:
        """Weights of the rows of every log."""
        return [_moving(one) for one in self.logs]

    def left_of(self, theta: Any, some: Sequence[Samples] | None = None) -> list[np.ndarray]:
        """Return what numbers leave of the logs, or of some of their samples."""
        numbers = self.numbers_of(jnp.asarray(theta))
        return [unexplained(self.model, numbers, one) for one in (self.logs if some is None else some)]

    def linearise(self, theta: Any, some: Sequence[Samples], lefts: Any) -> Any:
        """Return slopes and the air's forces of every log at these numbers."""
        guess = self.numbers_of(jnp.asarray(theta))
        return [
            (slopes_of(self.model, guess, one, self.chosen), air_of(self.model, guess, one, left))
            for one, left in zip(some, lefts, strict=True)
        ]

    def spectra(self, lefts: Any, linear: Any, counts: Sequence[int], step: int) -> list[Any]:
        """Return residuals, slopes and variances by frequency, from every `step`th of the first samples of each log.

        Beside them are the noise of thrusts in the slopes, and cover and spectrum of that of accelerations.
        """
        of_logs = []
        noises = [np.asarray(one.thrust_noise) for one in self.logs]
        for one, left, (slopes, air), weights, noise, count in zip(
            self.logs, lefts, linear, self.rows, noises, counts, strict=True
        ):
            if count:
                window, end = weights[:count:step], -(-count // step)
                by_thrust = window[:, :, None] * slopes[:end][:, :, self.offsets]
                left, by, spread = _transformed(
                    self.model.robot, window, left[:end], slopes[:end], air[:end], step * self.period, self.unmodelled
                )
                duration = step * self.period * end
                spectrum = _of_accelerations(np.asarray(one.velocity_noise)[0], len(left), duration)
                share = _taper(end) ** 2 / np.sum(_taper(end) ** 2)
                noisy = np.einsum("k,kij,kj->ij", share, by_thrust**2, noise[:count:step][:, : len(self.offsets)] ** 2)
                of_logs.append((left, by, spread, noisy, (share @ window**2, spectrum)))
        return of_logs

    def solve(self, start: Any, lefts: Any, linear: Any, counts: Sequence[int], step: int) -> tuple[Any, Any]:
        """Return numbers and their covariance in units of the prior, from the first samples of every log."""
        free, sigma, gains = self.free, self.sigma, self.gains
        of_mass = mass_slopes(self.model, self.numbers_of(jnp.asarray(start)), self.logs[0], self.chosen)
        spectra = self.spectra(lefts, linear, counts, step)
        theta = start.copy()
        covariance: np.ndarray = np.zeros((sigma.size, sigma.size))
        for _ in range(WEIGHED):
            information, slope = self.before.copy(), -self.before @ (theta[free] / sigma)
            if self.weighed is not None and self.width[0] > 0.0:
                mass = float(np.sum(self.model.robot.masses))
                by_mass = sigma[0] * mass / self.weighed[1]
                information[0, 0] += by_mass**2
                slope[0] += by_mass * (self.weighed[0] - mass * (1.0 + theta[0])) / self.weighed[1]
            for left, by, variance, noisy, (covered, spectrum) in spectra:
                added = _information(left + by @ (theta - start)[free], sigma * by, variance, covariance)
                information, slope = information + added[0], slope - added[1]
                # Noise of thrusts multiplies their gains, and that of accelerations masses, arms and inertias: without
                # what it adds to the residual in the mean, it would make them small.
                pull = added[2].sum(axis=0) @ noisy
                slope[gains] += sigma[gains] * pull
                # The residual is over the mass's factor.
                slope[: int(self.width[0] > 0.0)] -= sigma[0] * pull.sum()
                slope += sigma * np.tensordot((added[2] * covered).T @ spectrum, of_mass, 2)
            covariance = np.linalg.inv(information)
            theta[free] += sigma * (covariance @ slope)
        return theta, covariance

    def search(
        self, theta: Any, counts: Sequence[int], step: int, begin: Callable[[int], None]
    ) -> tuple[Any, Any, Any, float]:
        """Return numbers, their covariance, slopes at the last linearisation, and the last step in deviations.

        Slopes are kept as long as steps with them become shorter.
        """
        some = [
            Samples(*(part[: max(count, 1) : step] for part in one))
            for one, count in zip(self.logs, counts, strict=True)
        ]
        linear: Any = None
        is_stale, moved, linearised = True, np.inf, 0
        for number in range(STEPS):
            begin(number)
            lefts = self.left_of(theta, some)
            if is_stale:
                linear = self.linearise(theta, some, lefts)
                is_stale, linearised = False, linearised + 1
            old, (theta, covariance) = theta, self.solve(theta, lefts, linear, counts, step)
            last, moved = moved, _deviations((theta - old)[self.free], self.sigma, covariance)
            if moved < CONVERGED:
                break
            if moved > STALLED * last:  # as of drag in a wind that is to be found, whose slope changes with it
                theta = 0.5 * (theta + old)
                is_stale = linearised < LINEARISED
        return theta, covariance, linear, moved

    def predict(self, theta: Any, covariance: Any, linear: Any, known: Sequence[int]) -> list[Any]:
        """Return of every log what the first samples of all leave of its others, with deviations and weights."""
        if all(count >= len(one) for count, one in zip(known, self.rows, strict=True)):
            nothing = [left[:0] for left in self.rows]
            return [(one, one, one) for one in nothing]
        for _ in range(2):
            theta, covariance = self.solve(theta, self.left_of(theta), linear, known, 1)
        predicted = []
        for left, (slopes, *_), weights, count in zip(self.left_of(theta), linear, self.rows, known, strict=True):
            by = self.sigma * slopes[count:]
            predicted.append((left[count:], np.sqrt(np.sum(by * (by @ covariance), axis=-1)), weights[count:]))
        return predicted

    def whole(self, covariance: Any) -> np.ndarray:
        """Return the covariance of all numbers, with that of what motions imitate."""
        robot = self.model.robot
        full = np.zeros((self.width.size, self.width.size))
        full[np.ix_(self.free, self.free)] = covariance * np.outer(self.sigma, self.sigma)
        imitated = self.numbers_of(jnp.zeros(self.width.size))._replace(
            com=jnp.full(3, COHERENT * np.sum(robot.masses) / robot.masses[0]),
            inertia=jnp.array(COHERENT_INERTIA),
            delay=jnp.array([0.0, LATE]),
        )
        full += np.diag(np.where(self.width > 0.0, ravel_pytree(imitated)[0], 0.0) ** 2)
        return full


def _of_accelerations(noise: np.ndarray, size: int, duration: float) -> Float[np.ndarray, "f 6"]:
    """Return the spectrum of the noise of the base's accelerations, of white noise of its velocities."""
    rates = 2.0 * np.pi * np.arange(size)[:, None] / duration
    spectrum: np.ndarray = (noise * rates) ** 2 * np.exp(-((rates * WIDTH) ** 2))
    return spectrum


def _deviations(step: np.ndarray, sigma: np.ndarray, covariance: np.ndarray) -> float:
    """Return the greatest of a step's parts in deviations."""
    return float(np.max(np.abs(step) / (sigma * np.sqrt(np.diag(covariance))), initial=0.0))


def expected(model: Model, numbers: Numbers, estimate: Found, log: Samples, period: float) -> Float[np.ndarray, " p"]:
    """Return the standard deviations after one more log, of which the motion alone counts (p,).

    `numbers` are about the values of `found`. The noise is white and as large as what these leave of their last log.
    """
    free = np.flatnonzero(estimate.prior > 0.0)
    sigma = estimate.prior[free]
    slopes, left = slopes_of(model, numbers, log, tuple(free.tolist())), unexplained(model, numbers, log)
    air = air_of(model, numbers, log, left)
    _, by, spread = _transformed(model.robot, _moving(log), left, slopes, air, period)
    noise = np.broadcast_to(np.std(estimate.residuals[-1][1], axis=0), by.shape[:2])
    added, *_ = _information(noise, sigma * by, spread, np.zeros((free.size, free.size)))
    known = np.linalg.inv(estimate.covariance[np.ix_(free, free)] / np.outer(sigma, sigma))
    after = np.zeros(estimate.prior.size)
    after[free] = sigma * np.sqrt(np.diag(np.linalg.inv(known + added)))
    return after


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
    robot: RobotModel,
    weights: Float[np.ndarray, "k N"],
    left: Float[np.ndarray, "k N"],
    slopes: Float[np.ndarray, "k N p"],
    air: Float[np.ndarray, "k N"],
    period: float,
    unmodelled: tuple[float, float, float] = UNMODELLED,
) -> tuple[Complex[np.ndarray, "f N"], Complex[np.ndarray, "f N p"], Float[np.ndarray, "f N"]]:
    """Return the transforms of a residual and its derivatives, and the variance that no number explains.

    White noise keeps its variance. `air` are its forces.
    """
    count = len(left)
    taper, size = _taper(count), int(min(FREQUENCY, 0.4 / period) * count * period) + 1
    window = (taper / np.sqrt(np.sum(taper**2)))[:, None] * weights
    of_left, by, of_air = (
        np.fft.rfft(part, axis=0)[:size] for part in (window * left, window[:, :, None] * slopes, window * air)
    )
    return of_left, by, unmodelled_variance(robot, of_air, unmodelled)


def _information(
    left: Complex[np.ndarray, "f N"],
    by: Complex[np.ndarray, "f N p"],
    variance: Float[np.ndarray, "f N"],
    covariance: Float[np.ndarray, "p p"],
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"], Float[np.ndarray, "f N"]]:
    """Return information and slope of one log's likelihood, and the weight of every residual.

    In every band the spectrum is the mean of `variance` and the mean square of what is left, over the degrees of
    freedom that `covariance` leaves.
    """
    size = len(left)
    double = np.where(np.arange(size) == 0, 1.0, 2.0)  # a real and an imaginary part
    information, slope, of_rows = np.zeros((by.shape[2],) * 2), np.zeros(by.shape[2]), np.zeros(left.shape)
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
        of_rows[band] = scale**2
        slopes = (scale[:, :, None] * slopes).reshape(-1, by.shape[2])
        information += (slopes.conj().T @ slopes).real
        slope += (slopes.conj().T @ (scale * left[band]).reshape(-1)).real
    return information, slope, of_rows


def _taper(count: int) -> np.ndarray:
    """Return a window that rises and falls as a cosine at the ends."""
    edge = np.minimum(np.arange(count) + 0.5, count - np.arange(count) - 0.5) / (TAPER * count)
    window: np.ndarray = 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1.0))
    return window
