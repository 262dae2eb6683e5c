"""Whether a robot's model explains its log: what it predicts of samples that were held out, and usual mistakes.

    ratio² = mean r² / (n² + f²)        n the noise of the sensors in the residual r, f what no number explains
    bound² = 1 + q √(2 (n⁴/ν_n + f⁴/ν_f)) / (n² + f²)

`n` is what the residual changes by when the log's own white noise, which third differences of its rows show, is added
to it once more, and what coloured noise adds: velocities and derivatives of poses measure the same, and differ by noise
and by what goes with the motion, such as a clock or a delay. `f` has the estimate's `unmodelled_variance` and the
uncertainty of the numbers, which last; `ν` count samples that are independent, and `q` is a deviation of the normal
distribution that no right row of a log exceeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import wxyz_from_rotation
from jax_aero.identify import motion
from jax_aero.identify.motion import Model, Numbers, Samples
from jax_aero.identify.samples import PERIOD
from jax_aero.identify.search import Found

Array = NDArray[np.float64]
Signals = Mapping[str, Array]

CERTAIN = 5.0
"""`q`: rows are many, and what no number explains is not normal."""
LASTING = 2.0
"""Time over which what no number explains stays the same [s]: that of turbulence."""
LEAST_ROW = 0.9
"""Least time of a row by which a log is judged [s]."""
KINEMATIC = (0.03, 0.02)
"""Deviation of velocities and turning from the derivatives of pose, by sensors askew or late [m/s, rad/s]."""
COLOURED = (0.15, 0.1)
"""Greatest deviation of velocities and rates of turn that counts as noise [m/s, rad/s]."""
AGREE = (0.004, 0.008)
"""Differences of the scales of rates and of their times that no sensor's file states [1, s]."""
SEEN = 5.0
"""Deviations from which such a difference is there."""
SOME, TRIED = 120, 3
"""Samples by which mistakes are compared, and how many are then tried in full."""
LOAD = 0.05
"""Share of the weight from which something else carries the robot."""
SMALL = 1e-3
"""Acceleration that nobody measures [m/s², rad/s²]."""
BEYOND = 1.5
"""Half widths of its prior beyond which a number is in conflict with the file."""


class Row(NamedTuple):
    """Prediction of one acceleration in samples that were held out: root mean squares, `ratio` and `bound`."""

    name: str
    unit: str
    measured: float
    file: float
    found: float
    ratio: float
    bound: float


class Verdict(NamedTuple):
    """Rows of the test, and numbers that the file excludes."""

    rows: list[Row]
    conflicts: list[str]

    @property
    def is_explained(self) -> bool:
        """Return whether every row keeps its bound and no number is in conflict."""
        return not self.conflicts and not self.unexplained

    @property
    def unexplained(self) -> list[Row]:
        """Return the rows that exceed their bound."""
        return [row for row in self.rows if row.ratio > row.bound]

    @property
    def improvement(self) -> float:
        """Return what the file leaves of the base's accelerations over what the numbers leave."""
        file, numbers = (np.array([getattr(row, name) for row in self.rows[:6]]) for name in ("file", "found"))
        return float(np.exp(np.mean(np.log(np.hypot(file, SMALL) / np.hypot(numbers, SMALL)))))


def judge(
    model: Model,
    numbers: Numbers,
    estimate: Found,
    logs: Sequence[Samples],
    again: Sequence[Samples],
    known: Sequence[int],
    names: Sequence[str],
) -> Verdict:
    """Return the verdict on numbers that the first `known` samples of logs gave; `again` have their noise twice."""
    conflicts = conflicts_of(estimate, names)
    total: Any = 0.0
    squares: dict[str, Any] = dict.fromkeys(("measured", "file", "found", "error", "noise", "unmodelled"), 0.0)
    for log, more, (before, _), (left, spread, weight), count in zip(
        logs, again, estimate.residuals, estimate.held_out, known, strict=True
    ):
        if count == len(log.weight):
            continue
        sensors = compare_rates(log, more)
        conflicts += sensors.conflicts
        end, noisy = (Samples(*(part[count:] for part in one)) for one in (log, more))
        noise = motion.unexplained(model, numbers, noisy) - motion.unexplained(model, numbers, end)
        mass = motion.mass_matrices(model, numbers, end)
        air = motion.air_of(model, numbers, end, left)
        variance = np.concatenate(
            [
                motion.unmodelled_variance(model.robot, air) + spread**2,
                np.tile(np.square(np.repeat(KINEMATIC, 3)), (len(left), 1)),
            ],
            axis=1,
        )
        apart = _kinematic(end)
        coloured = np.sqrt(mass[:, :, :6] ** 2 @ sensors.acceleration)
        rows = {
            "measured": np.concatenate([measured(end), np.asarray(end.linear_velocity), end.gyro], axis=1),
            "file": np.concatenate([accelerations(mass, before[count:]), apart], axis=1),
            "found": np.concatenate([accelerations(mass, left), apart], axis=1),
            "error": np.concatenate([left, apart], axis=1),
            "noise": np.concatenate([np.hypot(noise, coloured), np.tile(sensors.noise, (len(left), 1))], axis=1),
            "unmodelled": np.sqrt(variance),
        }
        weight = np.concatenate([weight, np.tile(np.asarray(end.weight)[:, None], 6)], axis=1)
        total = total + weight.sum(axis=0)
        for key, part in rows.items():
            squares[key] = squares[key] + np.sum(weight * np.square(part), axis=0)
    count = np.maximum(total, 1e-9)
    mean = {key: part / count for key, part in squares.items()}
    noise, lasting = mean["noise"], np.maximum(mean["unmodelled"], 1e-30)
    spread = noise**2 / np.maximum(count / 1.3, 1.0) + lasting**2 / np.maximum(count * PERIOD / LASTING, 1.0)
    ratio = np.sqrt(mean["error"] / (noise + lasting))
    bound = np.sqrt(1.0 + CERTAIN * np.sqrt(2.0 * spread) / (noise + lasting))
    columns = [*(np.sqrt(mean[key]) for key in ("measured", "file", "found")), ratio, bound]
    table = [
        Row(name, unit, *(float(column[place]) for column in columns))
        for place, (name, unit) in enumerate(labels(model.robot))
        if total[place] * PERIOD > LEAST_ROW
    ]
    return Verdict(table, conflicts)


def conflicts_of(estimate: Found, names: Sequence[str]) -> list[str]:
    """Return the names of numbers that lie beyond what the file's stated error allows, with their deviations."""
    half = np.sqrt(3.0) * np.where(estimate.prior > 0.0, estimate.prior, np.inf)
    beyond = (np.abs(estimate.value) - 2.0 * estimate.deviation) / half
    places = np.flatnonzero(beyond > BEYOND).tolist()
    ended = [f"the search's last step, of {estimate.moved:.1f} deviations,"] if estimate.moved > 1.0 else []
    return [*(f"{names[place]} ({beyond[place]:.1f} times its prior)" for place in places), *ended]


def labels(robot: RobotModel) -> list[tuple[str, str]]:
    """Return name and unit of every row."""
    return [
        *((f"acceleration {axis}", "m/s²") for axis in "xyz"),
        *((f"acceleration {name}", "rad/s²") for name in ("rx", "ry", "rz", *robot.joint_names)),
        *((f"velocity {axis}", "m/s") for axis in "xyz"),
        *((f"turning r{axis}", "rad/s") for axis in "xyz"),
    ]


def accelerations(mass: Array, residual: Array) -> Array:
    """Return the errors of accelerations that residuals are: of the base, and of each joint, the others as measured."""
    base = np.linalg.solve(mass[:, :6, :6], residual[:, :6, None])[..., 0]
    return np.concatenate([base, residual[:, 6:] / np.diagonal(mass, axis1=1, axis2=2)[:, 6:]], axis=1)


def measured(log: Samples) -> Array:
    """Return the measured accelerations of base and joints (k, 6 + n)."""
    turned = np.einsum("kab,kb->ka", log.rotation, log.gyro_rate)
    return np.concatenate([log.linear_acceleration, turned, log.joint_acceleration], axis=1)


def _kinematic(log: Samples) -> Array:
    """Return by what rates of position and attitude differ from the measured ones (k, 6)."""
    apart = (log.position_rate - log.linear_velocity, log.turn_rate - log.gyro)
    return np.concatenate([np.asarray(part) for part in apart], axis=1)


class Sensors(NamedTuple):
    """Comparison of velocities and gyroscope with position and attitude.

    Attributes
    ----------
    noise
        Deviation of their difference, but for what goes with the motion (6,) [m/s, rad/s].
    acceleration
        Variance that noise which is not white adds to accelerations (6,) [(m/s²)², (rad/s²)²].
    """

    conflicts: list[str]
    noise: Array
    acceleration: Array


def compare_rates(log: Samples, more: Samples) -> Sensors:
    """Return what sensors say of each other; `more` has its white noise twice."""
    apart, weight = _kinematic(log), np.asarray(log.weight) > 0.0
    white = np.where(weight[:, None], _kinematic(more) - apart, 0.0)
    rest, scales, shares, conflicts = np.zeros_like(apart), [], [], []
    for part, names, rate, change in (
        (slice(0, 3), ("velocity", "position"), log.linear_velocity, log.linear_acceleration),
        (slice(3, 6), ("the gyroscope", "attitude"), log.gyro, log.gyro_rate),
    ):
        scale, late, rest[:, part] = _coherent(apart[:, part], np.asarray(rate), np.asarray(change), weight)
        scales.append(scale)
        # Noise in the rate itself makes its scale seem less: no more than twice its share in both.
        shares.append(2.0 * np.sum(rest[weight, part] ** 2) / np.sum(np.asarray(rate)[weight] ** 2))
        if abs(late[0]) > max(AGREE[1], SEEN * late[1]):
            conflicts.append(f"{names[1]} {-1e3 * late[0]:.0f} ms later than {names[0]}")
    known = np.array([deviation**-2 for _, deviation in scales])
    clock = float(known @ [scale for scale, _ in scales] / known.sum())
    if abs(clock) > max(AGREE[0], SEEN * known.sum() ** -0.5, float(known @ shares / known.sum())):
        conflicts.append(f"a clock, or rates, {-100.0 * clock:.2g} % fast")
    noise = np.minimum(np.sqrt(np.mean(rest[weight] ** 2, axis=0)), np.repeat(COLOURED, 3))
    power, of_white = (np.abs(np.fft.rfft(part, axis=0)) ** 2 for part in (rest, white))
    rates = 2.0 * np.pi * np.fft.rfftfreq(len(rest), PERIOD)[:, None]
    excess = np.sum(rates**2 * np.maximum(power - of_white, 0.0), axis=0) * 2.0 / (len(rest) * weight.sum())
    is_coloured = power.sum(axis=0) > 1.5 * of_white.sum(axis=0)
    share = noise**2 / np.maximum(np.mean(rest[weight] ** 2, axis=0), 1e-30)
    return Sensors(conflicts, noise, np.where(is_coloured, share * excess, 0.0))


def _coherent(apart: Array, rate: Array, change: Array, weight: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Return scale and delay of a difference of rates, each with its deviation, and what goes with neither (k, 3).

    `apart = A rate + delay change + offset`; the scale is the mean of A's diagonal.
    """
    eye = np.eye(3)
    columns = [np.einsum("a,kb->kab", eye[row], rate)[..., place] for row in range(3) for place in range(3)]
    columns += [change, *(np.broadcast_to(axis, rate.shape) for axis in eye)]
    by = np.stack(columns, axis=-1)
    some = by[weight].reshape(-1, by.shape[-1])
    inverse = np.linalg.pinv(some.T @ some + 1e-9 * np.eye(by.shape[-1]))
    fit = inverse @ (some.T @ apart[weight].reshape(-1))
    rest = np.where(weight[:, None], apart - by @ fit, 0.0)
    variance = 2.0 * np.sum(rest**2) / max(3 * weight.sum() - len(fit), 1)  # neighbours are not independent
    mean = np.zeros((2, len(fit)))
    mean[0, [0, 4, 8]], mean[1, 9] = 1.0 / 3.0, 1.0
    deviations = np.sqrt(variance * np.einsum("ap,pq,aq->a", mean, inverse, mean))
    scale, late = np.stack([mean @ fit, deviations], axis=1)
    return scale, late, rest


# Usual mistakes ------------------------------------------------------------------------------------------------------


class Mistake(NamedTuple):
    """A usual mistake, and the signals of a log as they are without it."""

    name: str
    without: Callable[[Signals], Signals]


def mistakes(signals: Signals, robot: rust.Robot) -> Iterator[Mistake]:
    """Yield what may be wrong with a log."""
    linear, angular = slice(0, 3), slice(3, 6)
    yield Mistake("thrusts in kgf", _scaled("raw_thrust", 9.80665))
    yield Mistake("thrusts in kN", _scaled("raw_thrust", 1e3))
    yield Mistake("thrusts with the other sign", _scaled("raw_thrust", -1.0))
    yield Mistake("velocities in mm/s", _scaled("raw_base_velocity", 1e-3, linear))
    yield Mistake("positions in mm", _scaled("raw_base_position", 1e-3))
    yield Mistake("rates of turn in deg/s", _scaled("raw_base_velocity", np.pi / 180.0, angular))
    yield Mistake("joint positions in degrees", _scaled("raw_joint_position", np.pi / 180.0))
    yield Mistake("rates of turn in base axes", _turned_rates)
    yield Mistake("quaternions as x, y, z, w", _other_order)
    yield Mistake("rotations of the world into the base", _transposed)
    yield Mistake("the sign of gravity: an axis z that points down", partial(_upside_down, base=False))
    yield Mistake("axes z of world and base that point down", partial(_upside_down, base=True))
    for name, what, of in (
        ("raw_thrust", "jets", robot.jet_names),
        ("raw_joint_position", "joints", robot.joint_names),
        ("joint_torque", "torques of joints", robot.joint_names),
    ):
        for one, other in combinations(range(len(of)), 2):
            # Of joints the next one, and that of the other side.
            if what == "jets" or of[one][1:] == of[other][1:] or other == one + 1:
                order = list(range(len(of)))
                order[one], order[other] = other, one
                yield Mistake(f"swapped {what} {of[one]} and {of[other]}", partial(_ordered, name=name, order=order))
    step = float(np.median(np.diff(signals["time"])))
    for name, what in (("raw_thrust", "thrusts"), ("joint_torque", "torques"), ("raw_base_rotation", "attitude")):
        for late in (0.05, 0.1, 0.2, 0.4):
            ticks = max(round(late / step), 1)
            for sign, word in ((ticks, "late"), (-ticks, "early")):
                yield Mistake(f"{what} about {late:g} s {word}", partial(_shifted, name=name, ticks=sign))
    for rate in (_clock(signals), 0.5, 2.0):
        yield Mistake(f"a clock that runs {rate:.3g} times as fast", _scaled("time", 1.0 / rate))


def _scaled(name: str, factor: float, part: slice = slice(None)) -> Callable[[Signals], Signals]:
    def change(signals: Signals) -> Signals:
        rows = signals[name].copy()
        rows[..., part] *= factor
        return {**signals, name: rows}

    return change


def _ordered(signals: Signals, name: str, order: list[int]) -> Signals:
    return {**signals, name: signals[name][:, order]}


def _shifted(signals: Signals, name: str, ticks: int) -> Signals:
    return {**signals, name: np.roll(signals[name], -ticks, axis=0)}


def _turned_rates(signals: Signals) -> Signals:
    velocity = signals["raw_base_velocity"]
    turned = np.einsum("kab,kb->ka", signals["raw_base_rotation"], velocity[:, 3:])
    return {**signals, "raw_base_velocity": np.hstack([velocity[:, :3], turned])}


def _other_order(signals: Signals) -> Signals:
    quaternion = np.roll(np.asarray(wxyz_from_rotation(signals["raw_base_rotation"])), 1, axis=1)
    return {**signals, "raw_base_rotation": rust.rotation_from_wxyz(quaternion)}


def _transposed(signals: Signals) -> Signals:
    return {**signals, "raw_base_rotation": np.swapaxes(signals["raw_base_rotation"], 1, 2)}


def _clock(signals: Signals) -> float:
    """Return the rate of the log's clock that velocities and steps of position show."""
    speed = np.diff(signals["raw_base_position"], axis=0) / np.diff(signals["time"])[:, None]
    velocity = signals["raw_base_velocity"][1:, :3]
    known = np.isfinite(speed).all(axis=1) & np.isfinite(velocity).all(axis=1)
    return float(np.clip(np.sum(velocity[known] ** 2) / np.sum(speed[known] * velocity[known]), 0.2, 5.0))


def _upside_down(signals: Signals, base: bool) -> Signals:
    """Return a log of axes with z down in those with z up: x the same, y the other way; and those of the base too."""
    flip = np.diag([1.0, -1.0, -1.0])
    changed = {name: signals[name] @ flip for name in ("raw_base_position", "raw_wind") if name in signals}
    rotation = flip @ signals["raw_base_rotation"] @ (flip if base else np.eye(3))
    velocity = signals["raw_base_velocity"] @ np.kron(np.eye(2), flip)
    return {**signals, **changed, "raw_base_rotation": rotation, "raw_base_velocity": velocity}


def score(model: Model, numbers: Numbers, log: Samples) -> float:
    """Return how badly numbers explain a log: the logarithm of what every row leaves and of what no number explains."""
    left = motion.unexplained(model, numbers, log)
    variance = motion.unmodelled_variance(model.robot, np.zeros_like(left))[0]
    squares = np.concatenate(
        [np.mean(left**2, axis=0) + variance, np.mean(_kinematic(log) ** 2, axis=0) + np.repeat(KINEMATIC, 3) ** 2]
    )
    return float(np.sum(np.log(squares)))
