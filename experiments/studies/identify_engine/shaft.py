"""Identification of an engine of the shaft's speed (M176) from speeds, thrusts, or both.

Least squares of the simulated speeds and of the thrusts, relative to their greatest values, over the whole run. Blocks
of `BLOCK` seconds are predicted by the fit to all others, and intervals take residuals of a block for one error, since
they last for seconds.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from jax_aero.base.terminal import Refused
from jax_aero.body.shaft import Ambient, Shaft, speed_rate, step_wanted, thrust_of, wanted_speed
from jax_aero.data.import_bench import Bench

Array = NDArray[np.float64]

STEP = 0.01
"""Sampling time of a run [s]."""
BLOCK = 5.0
"""Length of a block [s]."""
GAP = 0.5
"""Longest time between two readings over which a signal is linear [s]."""
STANDING = 0.06
"""Speed, a share of the greatest, below which a turbine gives no thrust."""
ZERO = 10.0
"""Time before and after a run in which the thrust of the standing turbine is averaged [s]."""

START = {
    "dead_time": 0.05,
    "lag_up": 1.0,
    "lag_down": 1.0,
    "acceleration": 0.2,
    "deceleration": 0.4,
    "exponent": 1.5,
    "square_share": 0.3,
    "ramp_up": 0.2,
    "ramp_down": 0.2,
    "idle": 0.3,
}
UNITS = {
    "dead_time": "s",
    "lag_up": "s",
    "lag_down": "s",
    "acceleration": "1/s",
    "deceleration": "1/s",
    "ramp_up": "1/s",
    "ramp_down": "1/s",
    "thrust_max": "N",
}
LEAST, GREATEST = 1e-3, 10.0
"""Bounds of these numbers."""


class Run(NamedTuple):
    """A run on the bench, sampled every `STEP`; NaN where nothing is known."""

    time: Array
    """Times [s]."""
    wanted: Array
    """Wanted speed, a share of `speed_max`; or NaN, and the throttle is known."""
    throttle: Array
    """Throttle [%]."""
    speed: Array
    """Speed of the shaft, a share of `speed_max`."""
    thrust: Array
    """Thrust without the drift of its zero [N]."""
    drift: Array
    """Drift of the thrust's zero [N]."""
    speed_max: float
    """Full speed [rpm]."""
    ambient: Ambient

    @property
    def has_wanted(self) -> bool:
        """Return whether the speed that the control unit demands is known."""
        return bool(np.isfinite(self.wanted).any())

    @property
    def blocks(self) -> Any:
        """Return the number of each sample's block."""
        return ((self.time - self.time[0]) / BLOCK).astype(int)

    @property
    def rises(self) -> Any:
        """Return where the last change of what is demanded was upwards."""
        change = np.sign(np.diff(self.wanted if self.has_wanted else self.throttle, prepend=np.nan))
        last = np.maximum.accumulate(np.where(np.nan_to_num(change) != 0.0, np.arange(change.size), 0))
        return change[last] >= 0.0


class Fitted(NamedTuple):
    """An identified engine."""

    numbers: dict[str, float]
    """Fields of `Shaft`, and `dead_time` [s] from demand to shaft."""
    interval: dict[str, tuple[float, float]]
    """Their 95 % intervals."""
    speed: Array
    """Simulated speed."""
    thrust: Array
    """Thrust at this speed [N]."""
    thrust_of_speed: Array
    """Thrust at the measured speed [N]."""
    held_out: Any
    """Speed and thrust of every block, predicted by the fit to the others."""

    @property
    def shaft(self) -> Shaft:
        """Return the engine."""
        return Shaft(**{name: self.numbers[name] for name in Shaft._fields})  # type: ignore[arg-type]


def sample(bench: Bench, span: tuple[float, float], ambient: Ambient) -> Run:
    """Return the part of a log within a span of time [s]; gaps longer than `GAP` stay gaps."""
    inside = (bench.time >= span[0]) & (bench.time <= span[1])
    if inside.sum() < 2:
        raise Refused(f"the log has {inside.sum()} rows from {span[0]:g} to {span[1]:g} s; expected 2 or more")
    time = np.arange(bench.time[inside][0], bench.time[inside][-1] + 0.5 * STEP, STEP)
    zero = zero_drift(bench, span)
    wanted, throttle, speed, thrust, drift = (
        resample(time, bench.time[inside], values[inside])
        for values in (bench.speed_wanted, bench.throttle, bench.speed, bench.thrust - zero, zero)
    )
    speed_max = next((float(np.nanmax(v)) for v in (wanted, speed) if np.isfinite(v).any()), np.nan)
    if np.isfinite(wanted).any():
        wanted = fill(wanted)
    elif np.isfinite(throttle).any():
        throttle = fill(throttle)
    else:
        raise Refused("the log has neither the speed that is wanted nor the throttle; expected one of them")
    if not (np.isfinite(speed).any() or np.isfinite(thrust).any()):
        raise Refused("the log has neither speeds nor thrusts; expected one of them")
    return Run(time, wanted / speed_max, throttle, speed / speed_max, thrust, drift, speed_max, ambient)


def resample(time: Array, stamps: Array, values: Array) -> Array:
    """Return values at other times, linear between readings that are no more than `GAP` apart."""
    stamps, values = stamps[np.isfinite(values)], values[np.isfinite(values)]
    if stamps.size < 2:
        return np.full(time.size, np.nan)
    after = np.clip(np.searchsorted(stamps, time), 1, stamps.size - 1)
    is_known = (stamps[after] - stamps[after - 1] <= GAP) & (time <= stamps[-1] + STEP)
    return np.where(is_known, np.interp(time, stamps, values), np.nan)


def fill(values: Array) -> Array:
    """Return values with those that are missing on the line between their neighbours."""
    row, known = np.arange(values.size), np.isfinite(values)
    return np.interp(row, row[known], values[known])


def zero_drift(bench: Bench, span: tuple[float, float]) -> Array:
    """Return the zero of the thrust at every row [N].

    It is read while the turbine stands, before and after the run. Between, it grows with the impulse of the thrust,
    whose heat warms the cell. Without speeds it is zero.
    """
    if not (np.isfinite(bench.speed).any() and np.isfinite(bench.thrust).any()):
        return np.zeros(bench.time.size)
    stands = (fill(bench.speed) < STANDING * np.nanmax(bench.speed)) & np.isfinite(bench.thrust)
    before, after = (np.flatnonzero(stands & side) for side in (bench.time < span[0], bench.time > span[1]))
    ends = [
        rows[np.abs(bench.time[rows] - bench.time[rows[near]]) <= ZERO]
        for rows, near in ((before, -1), (after, 0))
        if rows.size
    ]
    if not ends:
        return np.zeros(bench.time.size)
    impulse = np.cumsum(np.maximum(fill(bench.thrust), 0.0) * np.gradient(bench.time))
    zeros = [np.median(bench.thrust[rows]) for rows in ends]
    zero: Array = np.interp(impulse, [impulse[rows[0]] for rows in ends], zeros)
    return zero


def ramps(run: Run) -> dict[str, float]:
    """Return the greatest rates of the wanted speed [1/s]: those of its longest ways up and down without a stop."""
    change = np.diff(run.wanted)
    rates = {}
    for name, sign in (("ramp_up", 1.0), ("ramp_down", -1.0)):
        moves = np.concatenate([[0], (sign * change > 0.0).astype(int), [0]])
        starts, ends = (np.flatnonzero(np.diff(moves) == step) for step in (1, -1))
        ways = [(sign * change[a:b].sum(), b - a) for a, b in zip(starts, ends, strict=True)]
        way, steps = max(ways, default=(np.inf, 1))
        rates[name] = way / (steps * STEP)
    return rates


def identify(run: Run) -> Fitted:
    """Return the engine of a run, its intervals, and what the fits without each block predict of it."""
    given: dict[str, float] = {}
    if run.has_wanted:
        given = ramps(run) | {"idle": float(run.wanted.min())}
    if not np.isfinite(run.thrust).any():
        given |= {"thrust_max": np.nan, "square_share": 0.0}
    free = [name for name in (*START, "thrust_max") if name not in given]
    peak = float(np.nanmax(run.thrust)) if "thrust_max" in free else 1.0
    start = np.array([START.get(name, peak) for name in free])
    scale = np.array([peak if name == "thrust_max" else 1.0 for name in free])
    block = run.blocks
    count = int(block[-1]) + 1
    with jax.enable_x64(True):
        seen = np.stack([run.speed, run.thrust / peak])
        known = np.isfinite(seen)
        has_thrust = "thrust_max" in free

        def residual(values: Any, weight: Any) -> Any:
            speed, thrust, of_speed = predict(run, _named(free, values, given))
            at_best = jnp.where(known[0], of_speed, thrust) / peak if has_thrust else speed
            off = jnp.stack([speed, at_best]) - np.nan_to_num(seen)
            return (jnp.where(known, off, 0.0) * weight).ravel()

        off, slope = jax.jit(residual), jax.jit(jax.jacfwd(residual))

        def fit(start: Array, weight: Array) -> Array:
            solution = least_squares(
                lambda x: np.asarray(off(x, weight)),
                start,
                lambda x: np.asarray(slope(x, weight)),
                bounds=(LEAST * scale, GREATEST * scale),
                x_scale=scale,
            )
            return np.asarray(solution.x)

        all_rows = np.ones(run.time.size)
        whole = fit(start, all_rows)
        parts = [fit(whole, (block != left).astype(float)) for left in range(count)] if count > 1 else [whole]
        predict_now = jax.jit(lambda values: predict(run, _named(free, values, given)))
        predicted = [predict_now(values) for values in parts]
        speed, thrust, of_speed = (np.asarray(signal) for signal in predict_now(whole))
        gradient, residuals = np.asarray(slope(whole, all_rows)), np.asarray(off(whole, all_rows))
    reach = student.ppf(0.975, max(count - 1, 1)) * spread(gradient, residuals, block)
    rows = np.arange(run.time.size)
    held_out = tuple(np.array([part[signal] for part in predicted])[block, rows] for signal in (0, 1))
    numbers = {name: float(value) for name, value in (given | dict(zip(free, whole, strict=True))).items()}
    interval = {name: (numbers[name] - r, numbers[name] + r) for name, r in zip(free, reach, strict=True)}
    return Fitted(numbers, interval, speed, thrust, of_speed, held_out)


def spread(gradient: Array, residuals: Array, block: Array) -> Array:
    """Return the standard deviations of fitted numbers, whose residuals may be alike within each block.

    `J⁺ (Σ_b J_bᵀ r_b r_bᵀ J_b) J⁺ᵀ`, with the inverse of `JᵀJ` on both sides: cluster-robust least squares
    (Liang and Zeger, Biometrika 73 (1986) 13). Infinite for a number that no residual depends on.
    """
    inverse = np.linalg.pinv(gradient.T @ gradient)
    signals = residuals.size // block.size
    scores = np.zeros((block.max() + 1, gradient.shape[1]))
    np.add.at(scores, np.tile(block, signals), gradient * residuals[:, None])
    deviations = np.sqrt(np.diag(inverse @ scores.T @ scores @ inverse))
    return np.where(np.abs(gradient).max(axis=0) > 0.0, deviations, np.inf)


def _named(free: list[str], values: Any, given: dict[str, float]) -> dict[str, Any]:
    return given | {name: values[place] for place, name in enumerate(free)}


def predict(run: Any, numbers: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return the simulated speed, the thrust at it, and the thrust at the measured speed [N], from the first sample."""
    e = Shaft(**{name: numbers[name] for name in Shaft._fields})
    wanted = jnp.asarray(run.wanted)
    if not run.has_wanted:
        goal = wanted_speed(e, run.throttle)
        _, wanted = jax.lax.scan(lambda at, goal: (step_wanted(e, at, goal, STEP),) * 2, goal[0], goal)
    # Ramps and dead time commute; the wanted speed after them depends smoothly on both.
    wanted = jnp.interp(run.time - numbers["dead_time"], run.time, wanted)

    def step(speed: Any, wanted: Any) -> tuple[Any, Any]:
        return speed + STEP * speed_rate(e, speed, wanted, run.ambient), speed

    first = run.speed[0] if np.isfinite(run.speed[0]) else wanted[0]
    _, speed = jax.lax.scan(step, jnp.asarray(first), wanted)
    # A gap has no speed; its thrust is not compared.
    measured = jnp.where(np.isfinite(run.speed), run.speed, 1.0)
    return speed, thrust_of(e, speed, run.ambient), thrust_of(e, measured, run.ambient)


def listing(run: Run, fitted: Fitted) -> dict[str, str]:
    """Return every number of an engine with its unit and interval, by name."""
    texts = {"speed_max [rpm]": f"{run.speed_max:.0f}"} if np.isfinite(run.speed_max) else {}
    for name, value in fitted.numbers.items():
        least, greatest = fitted.interval.get(name, (value, value))
        of = f"({least:.3g} to {greatest:.3g})" if np.isfinite(greatest) else "(not reached)"
        text = f"{value:.4g}" if name not in fitted.interval else f"{value:.4g} {of}"
        texts[f"{name} [{UNITS.get(name, '1')}]"] = text
    return texts


def errors(run: Run, speed: Array, thrust: Array, full: float, label: str) -> dict[str, float]:
    """Return rms errors of speeds [% of the full speed] and thrusts [N, % of `full`], while the demand rises and falls.

    Thrusts are compared without the drift of their zero, and, as logged, with it.
    """
    figures = {}
    for way, rows in (("rise", run.rises), ("fall", np.logical_not(run.rises))):
        off = {
            "speed [% of full speed]": 100.0 * (speed - run.speed),
            "thrust [N]": thrust - run.thrust,
            "thrust [% of full thrust]": 100.0 * (thrust - run.thrust) / full,
            "thrust as logged [N]": thrust - run.thrust - run.drift,
        }
        for what, values in off.items():
            known = values[rows & np.isfinite(values)]
            if known.size and np.any(known):
                figures[f"{label}, {way}: rms error of {what}"] = float(np.sqrt(np.mean(known**2)))
    return figures
