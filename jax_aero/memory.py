"""Whether a controller and its copy stay together: the derivative of its ticks, its own command fed back.

Two computers that receive the same measurements differ by roundings, and each continues from what it commanded itself.
Where a linear controller has the gain K, its estimator the gain L and the robot the model (A, B, C), the difference of
their states follows A − B K − L C. That A − B K and A − L C are stable, and with them the flight, says nothing of it.

Here both replay the log of a hover; in one tick the copy's measurements differ by a little. What then differs is the
derivative of the ticks that follow, from state to state with measurements held, applied to that little. Its greatest
eigenvalues follow from the commands by dynamic mode decomposition.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jax_aero import backends, rust

Array = NDArray[np.float64]

DURATION = 8.0
"""Duration of the hover [s]."""

START, SETTLED = 2.0, 3.0
"""Times of the tick in which the copy is given something else, and from which the eigenvalues count [s]."""

NUDGE = 1e-7
"""Standard deviation of what else it is given, in each unit: far above roundings, far below what flips a choice."""

PAIR = 2
"""Ticks of a step of the decomposition: the predictive law plans in every second one."""

STEPS, RANK, NOISE = 10, 4, 1e-4
"""Steps of a sample, greatest number of eigenvalues, least share of the greatest singular value that is no noise."""

GROWTH_MAX = 1.003
"""Growth in a tick up to which a copy stays: integrals keep a difference (1), which is found within 0.002."""


class Growth(NamedTuple):
    """What becomes of a difference between a controller and its copy.

    Attributes
    ----------
    eigenvalues
        Greatest eigenvalues of the derivative of one tick, the greatest first, complex.
    time, difference
        Time since the copy was given something else [s], (ticks,), and greatest difference of the commands of two
        copies, as a multiple of what they were given [N m, N/s], (ticks, 2).
    time_step
        Of the tick [s].
    """

    eigenvalues: NDArray[np.complex128]
    time: Array
    difference: Array
    time_step: float

    @property
    def greatest(self) -> float:
        """Factor by which a difference grows in a tick."""
        return float(abs(self.eigenvalues[0]))

    @property
    def frequency(self) -> float:
        """Frequency with which it oscillates [Hz]."""
        return float(abs(np.angle(self.eigenvalues[0])) / (2.0 * np.pi * self.time_step))

    @property
    def stays(self) -> bool:
        """Whether the copy stays with the controller."""
        return self.greatest <= GROWTH_MAX

    def __str__(self) -> str:
        if self.stays:
            return "stays with it"
        tenfold = self.time_step * np.log(10.0) / np.log(self.greatest)
        return f"parts from it: a difference grows tenfold in {tenfold:.1f} s, at {self.frequency:.1f} Hz"


def growth(config: Mapping[str, Any], log: Mapping[str, ArrayLike] | None = None) -> Growth:
    """Return what becomes of a difference between a controller and its copy in a hover.

    `log` has the signals of a flight of this configuration, of at least `DURATION`; by default its robot flies in still
    air, without a mission. One with ground stands on it.
    """
    if log is None:
        config = at_rest(config)
        log = backends.backend(backends.backend_of(config)).fly(config).log
    step = float(config["controller"]["time_step"])
    first, settled = round(START / step), round(SETTLED / step)
    own = _commands(config, log)
    apart = [(_commands(config, _nudged(log, first, seed)) - own)[first:] / NUDGE for seed in (0, 1)]
    difference = np.stack([np.abs(commands).max(axis=1) for commands in apart], axis=1)
    greatest = eigenvalues([commands[settled - first :] for commands in apart])
    return Growth(greatest, np.arange(len(difference)) * np.float64(step), difference, step)


def at_rest(config: Mapping[str, Any]) -> rust.Config:
    """Return a flight of `DURATION` without mission, wind and disturbances."""
    still = {"profile": "constant", "velocity": [0.0, 0.0, 0.0]}
    changed = {**config, "mission": {}, "disturbances": {}, "wind": still}
    return rust.resolve_config(rust.set_keys(changed, {"simulator.duration": DURATION}))


def eigenvalues(samples: list[Array]) -> NDArray[np.complex128]:
    """Return the greatest eigenvalues of a tick of which these are outputs (ticks, n), the greatest first.

    Dynamic mode decomposition: with columns x_k of the outputs of `STEPS` steps, X₁ = (x_{k+1}) = A X₀, and the
    eigenvalues of A on the greatest singular vectors of X₀ = U Σ Vᵀ are those of Σ⁻¹ Uᵀ X₁ V.
    """
    before, after = [], []
    for ticks in samples:
        steps = ticks[: len(ticks) // PAIR * PAIR].reshape(len(ticks) // PAIR, -1)
        columns = np.stack([steps[k : k + STEPS].ravel() for k in range(len(steps) - STEPS + 1)], axis=1)
        before.append(columns[:, :-1])
        after.append(columns[:, 1:])
    x_0, x_1 = np.hstack(before), np.hstack(after)
    scale = np.abs(x_0).max()
    if scale == 0.0:
        return np.zeros(1, np.complex128)
    u, sigma, v = np.linalg.svd(x_0 / scale, full_matrices=False)
    rank = min(RANK, int(np.sum(sigma > NOISE * sigma[0])))
    reduced = u[:, :rank].T @ (x_1 / scale) @ v[:rank].T / sigma[:rank]
    values = np.linalg.eigvals(reduced).astype(np.complex128) ** (1.0 / PAIR)
    return values[np.argsort(-np.abs(values))]


def _commands(config: Mapping[str, Any], log: Mapping[str, ArrayLike]) -> Array:
    """Return torques and thrust rates of a replay, (ticks, n + jets)."""
    replayed = rust.replay(config, log)
    return np.hstack([replayed["joint_torque"], replayed["thrust_rate"]])


def _nudged(log: Mapping[str, ArrayLike], tick: int, seed: int) -> dict[str, Array]:
    """Return the log with measurements of one tick that differ by normal numbers of the size `NUDGE`."""
    rng = np.random.default_rng(seed)
    signals = {name: np.array(rows, np.float64) for name, rows in log.items() if rust.is_input(name)}
    for name, rows in signals.items():
        if name != "time":
            rows[tick] += NUDGE * rng.normal(size=rows[tick].shape)
    return signals
