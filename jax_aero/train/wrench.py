"""Observed wrenches as what a network of link forces is trained on: estimates of a disturbance observer in flights.

    w = q (R Σ a, R Σ x × a),   q = ρ/2 |v|²                       force and moment about the centre of mass
    z_k = z_{k−1} + (1 − e^{−K Δt}) (½ (w_k + w_{k−1}) − z_{k−1})     the observer's filter [M84], by rows Δt apart
    e_k = (z_k + C_k c − ẑ_k) / σ,   C = filtered (diag(R, R), e₃)
    loss = mean |e|² + 1/(K T) |c / σ_c|² + s mean |a / a₀|²,   c the minimum

with areas `a` and arms `x` of the links in base axes, the rotation `R` of the base, and the observed wrench `ẑ`. Seven
constants `c` a window of T seconds are what wrong thrusts and a wrong centre of mass do, turned with the robot, and a
wrong mass, which is not. They follow from the other errors in closed form, so that they need no training. The last term
decides what the total does not determine: the forces of single links stay small.

Arrays: W windows, T rows, L links; forces [N], moments [N m].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jax_aero.aero.network import Network, baseline_areas, raw_output, to_base_axes
from jax_aero.types import Array

CONSTANTS = 7
"""Constants of a window: force and moment in base axes, and a vertical force."""


class Windows(NamedTuple):
    """Parts of flights: arrays in single precision, of NumPy or traced; without W those of one window."""

    x: Any
    """(W, T, copies, n) features of the rows, and for a symmetric network those of their mirror images."""
    turn: Any
    """(W, T, 3, 3) rotation of the base."""
    pressure: Any
    """(W, T) dynamic pressure at the base [Pa]."""
    wind: Any
    """(W, T, 3) unit vector of the air's velocity relative to the base, base axes."""
    rotations: Any
    """(W, T, L, 3, 3) `base_from_link`."""
    axes: Any
    """(W, T, L, 3) unit axes of the links, base axes."""
    arms: Any
    """(W, T, L, 3) aerodynamic centres relative to the centre of mass, base axes [m]."""
    seen: Any
    """(W, T, 6) observed wrench, inertial axes."""
    weight: Any
    """(W, T) 1 for rows that count, 0 for others."""
    constants: Any
    """(W, T, 6, 7) estimate of each constant."""
    solve: Any
    """(W, 7, 7) matrix that makes the best constants of the gradient of the squared errors."""


class Errors(NamedTuple):
    """What a wrench leaves of the observed one, with the best constants."""

    of_rows: Float[Array, "T 6"]
    """`e`, zero in rows that do not count."""
    constants: Float[Array, "7"]
    """`c` [N, N m]."""


@dataclass(frozen=True)
class ObservedWrenches:
    """The objective; `jax_aero.train.loop.Objective`."""

    frame: str
    layout: str
    """Of the network's output."""
    gain: tuple[float, float]
    """`K` of the observer for force and moment [1/s]; infinite for a balance, which is not filtered."""
    step: float
    """`Δt` between rows [s]."""
    noise: tuple[float, float]
    """`σ`: standard deviation of an observed force and moment [N, N m]."""
    deviation: tuple[float, float, float]
    """`σ_c`: of constant force, moment, and vertical force [N, N m, N]; zero for none."""
    area: float
    """`a₀`: usual size of the areas that are learnt [m²], which scales the outputs."""
    shrink: float
    """`s`: weight of the areas' squares."""

    # --- as an objective of the loop ---

    def scaled(self, network: Network, training: Windows) -> Network:
        """Scale by `a₀` and begin with zero: with the baseline alone."""
        del training
        last = network.layers[-1]
        last = replace(last, weight=jnp.zeros_like(last.weight), bias=jnp.zeros_like(last.bias))
        return replace(
            network,
            layers=(*network.layers[:-1], last),
            scale=jnp.full_like(network.scale, self.area),
            offset=jnp.zeros_like(network.offset),
        )

    def given(self, network: Network, training: Windows) -> tuple[Any, Any]:
        """Return windows without features and areas of the baseline, and the network's scale, offset and reflection."""
        base = jax.jit(jax.vmap(jax.vmap(lambda wind, axes: _base(network, wind, axes))))
        areas = base(training.wind, training.axes)
        windows = jax.tree.map(jnp.asarray, training._replace(x=np.zeros(len(training.x))))
        mirror = None if network.mirror is None else jnp.asarray(network.mirror.output, jnp.float32)
        return (windows, areas), (network.scale, network.offset, mirror)

    def loss(
        self, output: Float[Array, "m B T copies y"], rows: tuple[Windows, Float[Array, "B T l 3"]], common: Any
    ) -> Float[Array, ""]:
        """Return the mean loss of members and windows."""
        scale, offset, mirror = common
        y = scale * output + offset
        y = y[..., 0, :] if mirror is None else 0.5 * (y[..., 0, :] + y[..., 1, :] @ mirror.T)

        def of_window(y: Array, window: Windows, base: Array) -> Array:
            learnt = jax.vmap(lambda y, turn: to_base_axes(self.frame, self.layout, y, turn))(y, window.rotations)
            left = self.errors(learnt + base, window)
            counted = jnp.maximum(jnp.sum(window.weight), 1.0)
            small = jnp.sum(window.weight[:, None, None] * (learnt / self.area) ** 2) / (3.0 * learnt.shape[1])
            prior = jnp.sum((left.constants * self._per_deviation) ** 2)
            fit = jnp.sum(left.of_rows**2) / 6.0 + prior * self.rows_per_observation / 6.0
            return (fit + self.shrink * small) / counted

        return jnp.mean(jax.vmap(jax.vmap(of_window), (0, None, None))(y, *rows))

    def unit(self, network: Network) -> float:
        """Return one: a loss is in squared standard deviations."""
        del network
        return 1.0

    def error(self, network: Network, validation: Windows) -> float:
        """Return the mean square of the errors of a network as it flies, in standard deviations."""
        errors = self.evaluate(network, validation)
        return float(np.sum(np.asarray(errors.of_rows) ** 2) / max(6.0 * float(validation.weight.sum()), 1.0))

    # --- evaluation ---

    def evaluate(self, network: Network, windows: Windows) -> Errors:
        """Return what a network leaves of every window, (W, …)."""

        def of_row(row: Windows) -> Array:
            y = raw_output(network, row.x[0])
            learnt = to_base_axes(self.frame, self.layout, y, row.rotations)
            return learnt + _base(network, row.wind, row.axes)

        @jax.jit
        def of_window(window: Windows) -> Errors:
            rows = window._replace(solve=jnp.zeros(len(window.x)))
            return self.errors(jax.vmap(of_row)(rows), window)

        return self.each(of_window, windows)

    @staticmethod
    def each(of_window: Callable[[Windows], Errors], windows: Windows) -> Errors:
        """Return what is left of windows, one after the other: they need little memory."""
        parts = [of_window(Windows(*one)) for one in zip(*windows, strict=True)]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *parts)  # type: ignore[no-any-return]

    def rms(self, left: Errors, windows: Windows) -> tuple[float, float]:
        """Return the root mean square lengths of force and moment that are left [N, N m]."""
        squares = np.sum((np.asarray(left.of_rows, np.float64) * self._sigma) ** 2, axis=(0, 1))
        count = max(float(windows.weight.sum()), 1.0)
        return float(np.sqrt(squares[:3].sum() / count)), float(np.sqrt(squares[3:].sum() / count))

    def errors(self, areas: Float[Array, "T L 3"], window: Windows) -> Errors:
        """Return what areas [m²] leave of a window."""
        total = jax.vmap(wrench)(areas, window.arms, window.turn, window.pressure)
        return self.left(self.filtered(total, window.seen[0]), window)

    def left(self, predicted: Float[Array, "T 6"], window: Windows) -> Errors:
        """Return what a wrench, as observed, leaves of a window."""
        weight = window.weight[:, None] / self._sigma
        before = weight * (predicted - window.seen)
        basis = weight[:, :, None] * window.constants
        constants = -window.solve @ jnp.einsum("tac,ta->c", basis, before)
        return Errors(before + basis @ constants, constants)

    def filtered(self, total: Float[Array, "T 6 ..."], start: Float[Array, "6 ..."]) -> Float[Array, "T 6 ..."]:
        """Return the observer's estimate of a wrench (T, 6), or of columns (T, 6, …), from its state at first."""
        share = jnp.asarray(self._share).reshape(6, *[1] * (start.ndim - 1))

        def tick(carry: tuple[Array, Array], now: Array) -> tuple[tuple[Array, Array], Array]:
            held, before = carry
            held = held + share * (0.5 * (now + before) - held)
            return (held, now), held

        return jax.lax.scan(tick, (start, total[0]), total)[1]

    def with_constants(self, windows: Windows) -> Windows:
        """Return windows with what their constants do."""
        turn = np.asarray(windows.turn, np.float64)
        raw = np.zeros((*turn.shape[:2], 6, CONSTANTS))
        raw[:, :, :3, :3], raw[:, :, 3:, 3:6], raw[:, :, 2, 6] = turn, turn, 1.0
        # From zero, since what the observer holds at first has the constants already.
        seen = np.stack([np.asarray(self.filtered(one, 0.0 * one[0])) for one in raw.astype(np.float32)])
        basis = (windows.weight[:, :, None] / self._sigma)[..., None] * seen
        of_data = np.einsum("wtac,wtad->wcd", basis, basis).astype(np.float64)
        is_free = np.asarray(self._per_deviation) > 0.0
        prior = np.diag(np.where(is_free, self._per_deviation**2 * self.rows_per_observation, 1.0))
        both = np.outer(is_free, is_free)
        solve = np.where(both, np.linalg.inv(np.where(both, of_data, 0.0) + prior), 0.0)
        return windows._replace(constants=seen, solve=solve.astype(np.float32))

    @property
    def _share(self) -> Any:
        return np.repeat(1.0 - np.exp(-np.asarray(self.gain) * self.step), 3).astype(np.float32)

    @property
    def _sigma(self) -> Any:
        return np.repeat(self.noise, 3).astype(np.float32)

    @property
    def _per_deviation(self) -> Any:
        """Return `1 / σ_c`, zero for constants that are none."""
        deviation = np.repeat(self.deviation, [3, 3, 1])
        return np.where(deviation > 0.0, 1.0 / np.where(deviation > 0.0, deviation, 1.0), 0.0).astype(np.float32)

    @property
    def rows_per_observation(self) -> float:
        """Return how many rows one independent observation takes: those within `1 / K`."""
        return 1.0 / (min(self.gain) * self.step) if np.isfinite(min(self.gain)) else 1.0


def wrench(
    areas: Float[Array, "L 3"], arms: Float[Array, "L 3"], turn: Float[Array, "3 3"], pressure: Float[Array, ""]
) -> Float[Array, "6"]:
    """Return total force and moment about the centre of mass [N, N m], inertial axes, of areas in base axes [m²]."""
    return pressure * jnp.concatenate([turn @ areas.sum(0), turn @ jnp.cross(arms, areas).sum(0)])


def _base(network: Network, wind: Float[Array, "3"], axes: Float[Array, "L 3"]) -> Float[Array, "L 3"]:
    """Return the areas of the network's baseline [m²], base axes; zero without one."""
    return jnp.zeros_like(axes) if network.baseline is None else baseline_areas(network.baseline, wind, axes)


def windows_of(
    count: int, length: int, is_valid: Bool[np.ndarray, " k"], settling: int
) -> list[tuple[slice, Float[np.ndarray, " T"]]]:
    """Return windows of `length` rows that cover `count` rows, but for a tenth of one, and which of their rows count.

    A row counts if it, and all rows of the `settling` before it in its window, are valid: the observer no longer
    depends on what it held before.
    """
    length = min(length, count)
    number = max(1, int(np.ceil(count / length - 0.1)))
    starts = np.unique(np.linspace(0, count - length, number).round().astype(int))
    windows = []
    for start in starts.tolist():
        here = slice(start, start + length)
        is_wrong = np.concatenate([np.ones(settling, dtype=bool), ~is_valid[here]])
        near = np.convolve(is_wrong, np.ones(settling + 1), mode="full")[settling : settling + length]
        windows.append((here, (near < 0.5).astype(np.float64)))
    return windows
