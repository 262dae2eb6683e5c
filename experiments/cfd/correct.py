"""Correction of the panel model by simulations.

The force area of a link is linear in the twelve coefficients b of its family, F = G b. The coefficients of the panel
model, b₀, are corrected towards the simulations, family by family:

    minimise  Σ |G b − F|² + λ s |b − b₀|²,      s = tr(G'G)/12
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jax_aero.aero.dataset import Dataset, Floats
from jax_aero.aero.surrogate import TERMS, Features, Surrogate, force_areas
from jax_aero.aero.surrogate_fit import FAMILY_OF, N_FAMILIES

PENALTIES = tuple(10.0**power for power in range(-6, 2))
"""Candidate values of λ."""


class Sums(NamedTuple):
    """Normal equations of P postures and K families."""

    matrix: Float[np.ndarray, "P K 12 12"]
    """G'G [m⁴]."""
    right: Float[np.ndarray, "P K 12"]
    """G'F [m⁴]."""

    def select(self, postures: Floats) -> Sums:
        """Return the sums over the postures selected by a mask (P,)."""
        return Sums(self.matrix[postures], self.right[postures])


class Correction(NamedTuple):
    """Result of a correction."""

    coefficients: Float[np.ndarray, "K 12"]
    """Coefficients by family, from all rows."""
    penalty: float
    """λ of these coefficients."""
    left_out_b: Float[np.ndarray, "B L 3"]
    """Force areas [m²], base axes, from coefficients fitted without the row's posture."""


def correct_panels(panels: Surrogate, features: Features, data: Dataset) -> Correction:
    """Correct the panel model, also with each posture left out; λ is chosen by leave-one-out on the remaining ones."""
    rows = features(data.joint_position_deg, data.wind_b)
    postures = np.unique(data.family)
    sums = sums_of(rows, data, postures)
    start = np.array([panels.coefficients[family == FAMILY_OF][0] for family in range(N_FAMILIES)])
    areas = np.zeros_like(data.force_area_b)
    for posture in postures:
        found, _ = _choose_penalty(sums.select(postures != posture), start)
        own = data.family == posture
        areas[own] = force_areas(found[FAMILY_OF], rows[own])
    coefficients, penalty = _choose_penalty(sums, start)
    return Correction(coefficients, penalty, areas)


def sums_of(features: Float[np.ndarray, "B L 12 3"], data: Dataset, postures: Floats) -> Sums:
    """Return the normal equations of every posture."""
    matrix = np.zeros((len(postures), N_FAMILIES, len(TERMS), len(TERMS)))
    right = np.zeros(matrix.shape[:-1])
    for number, posture in enumerate(postures):
        own = data.family == posture
        for link, family in enumerate(FAMILY_OF):
            g = np.swapaxes(features[own, link], 1, 2).reshape(-1, len(TERMS))
            matrix[number, family] += g.T @ g
            right[number, family] += g.T @ data.force_area_b[own, link].ravel()
    return Sums(matrix, right)


def solve(sums: Sums, start: Float[np.ndarray, "K 12"], penalty: float) -> Float[np.ndarray, "K 12"]:
    """Return the coefficients fitted to all postures together."""
    matrix, right = sums.matrix.sum(axis=0), sums.right.sum(axis=0)
    ridge = penalty * np.trace(matrix, axis1=1, axis2=2)[:, None] / len(TERMS)
    found: Floats = (
        start
        + np.linalg.solve(
            matrix + ridge[..., None] * np.eye(len(TERMS)), (right - np.einsum("kij,kj->ki", matrix, start))[..., None]
        )[..., 0]
    )
    return found


def _choose_penalty(sums: Sums, start: Floats) -> tuple[Floats, float]:
    """Return coefficients and λ with the least squared error on left-out postures."""

    def error(penalty: float) -> float:
        off = 0.0
        for number in range(len(sums.right)):
            own = np.arange(len(sums.right)) == number
            b = solve(sums.select(~own), start, penalty)
            # |G b − F|² without the constant |F|².
            off += np.einsum("ki,kij,kj->", b, sums.matrix[number], b) - 2.0 * np.sum(b * sums.right[number])
        return off

    penalty = min(PENALTIES, key=error)
    return solve(sums, start, penalty), penalty
