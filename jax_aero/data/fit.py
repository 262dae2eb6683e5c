"""Fit of the paper's axisymmetric model to a dataset; a Lasso selects the terms for each link family.

    C_D A(α) = Σ_k w_k cos^i α sin^j α,   i + j ≤ 3,   with zero slope at 0° and 180°
    C_N A(α) = w₅ sin² α cos α

Source: paper, Methods, "Aerodynamic modelling for learning and online control". The normal force differs: we fit it
with its sign, along `(v × k̂) × v`, whereas the published coefficients are fits of its magnitude, which we fit only for
comparison. The Lasso penalty, which the paper does not give, is chosen by leaving postures out.

Equation M29 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jax_aero.aero.dataset import Dataset, Floats, Indices
from jax_aero.base import tables
from jax_aero.body.robot import RobotModel

MODEL_TERMS = ((0, 0), (1, 0), (0, 2), (0, 3), (3, 0))
"""Powers (i, j) of cos and sin of the terms of `w0 .. w4` in the drag area.

Zero slope at both poles requires j ≠ 1. Up to order 3 all other terms are sums of these (cos² = 1 − sin²).
"""
TOLERANCE = 0.01
"""Largest relative increase of the held-out error, over the best model's, that is accepted for fewer terms."""


class Angles(NamedTuple):
    """Orientation of links in the wind."""

    cos: Float[np.ndarray, "B L"]
    """Cosine of the angle between the link's axis and the upstream direction."""
    sin: Float[np.ndarray, "B L"]
    normal: Float[np.ndarray, "B L 3"]
    """`(ŵ × k̂) × ŵ`, of length sin α."""
    wind: Float[np.ndarray, "B 1 3"]
    """Unit vector of the air's motion, base axes."""


class Parts(NamedTuple):
    """Components of a force area along and normal to the wind."""

    drag: Float[np.ndarray, " *batch"]
    """Component along the wind [m²]."""
    across: Float[np.ndarray, "*batch 3"]
    """Component normal to the wind [m²], base axes."""


@dataclass(frozen=True)
class FamilyFit:
    """Fitted model of one family of links."""

    terms: tuple[tuple[int, int], ...]
    """Powers (of cos, of sin) of the selected terms."""
    cda: Float[np.ndarray, "5"]
    """`w0 .. w4` [m²]; zero for a term that was not selected."""
    cna: float
    """`w5` of the signed normal force [m²]."""
    cna_of_magnitude: float
    """`w5` of the magnitude of the normal force [m²], as the paper seems to have fitted it."""

    @property
    def coefficients(self) -> Float[np.ndarray, "6"]:
        """`w0 .. w5`, with the signed normal force [m²]."""
        return np.array([*self.cda, self.cna])


def families_of(robot: RobotModel) -> dict[str, tuple[str, ...]]:
    """Return the links that share coefficients, by family, from the robot's file."""
    families: dict[str, tuple[str, ...]] = {}
    for link in tables.read(Path(robot.source))["aero_links"]:
        families[link["family"]] = (*families.get(link["family"], ()), link["name"])
    return families


def angles(axes: Float[np.ndarray, "B L 3"], wind_b: Float[np.ndarray, "B 3"]) -> Angles:
    """Return the angles of attack of links with unit axes, base axes."""
    wind = wind_b[:, None, :]
    along = np.sum(axes * wind, axis=-1, keepdims=True)
    cos = np.clip(-along[..., 0], -1.0, 1.0)
    return Angles(cos, np.sqrt(1.0 - cos**2), axes - along * wind, wind)


def parts(force_area_b: Float[np.ndarray, "B L 3"], wind: Float[np.ndarray, "B 1 3"]) -> Parts:
    """Split force areas, base axes, into their components along and normal to the wind."""
    drag = np.sum(force_area_b * wind, axis=-1)
    return Parts(drag, force_area_b - drag[..., None] * wind)


def columns_of(
    terms: Sequence[tuple[int, int]], cos: Float[np.ndarray, " B"], sin: Float[np.ndarray, " B"]
) -> Float[np.ndarray, "B k"]:
    """Return the design matrix of the terms, one row for each angle."""
    return np.stack([cos**i * sin**j for i, j in terms], axis=1)


def fit_family(
    cos: Float[np.ndarray, " B"],
    sin: Float[np.ndarray, " B"],
    force: Parts,
    normal: Float[np.ndarray, "B 3"],
    posture: Int[np.ndarray, " B"],
) -> FamilyFit:
    """Fit the links of one family, from the angles, force areas, normal directions and posture number of each row."""
    matrix = columns_of(MODEL_TERMS, cos, sin)
    supports = lasso_supports(matrix, force.drag)
    errors = {support: _held_out_error(matrix[:, list(support)], force.drag, posture) for support in supports}
    enough = (1.0 + TOLERANCE) * min(errors.values())
    chosen = min((support for support in errors if errors[support] <= enough), key=lambda s: (len(s), errors[s]))
    weights = np.zeros(len(MODEL_TERMS))
    weights[list(chosen)] = least_squares(matrix[:, list(chosen)], force.drag)
    shape = sin**2 * cos
    direction = (sin * cos)[:, None] * normal
    size = np.linalg.norm(force.across, axis=-1)
    return FamilyFit(
        terms=tuple(MODEL_TERMS[index] for index in chosen),
        cda=weights,
        cna=float(np.sum(direction * force.across) / np.sum(direction**2)),
        cna_of_magnitude=float(np.sum(np.abs(shape) * size) / np.sum(shape**2)),
    )


def lasso_supports(matrix: Float[np.ndarray, "B k"], target: Float[np.ndarray, " B"]) -> dict[tuple[int, ...], float]:
    """Return the sets of columns that some Lasso penalty selects, with the smallest such penalty over the largest.

    The first column is the constant. It is not penalised, since other terms would then replace it; every set is
    returned with and without it.
    """
    # Imported here, since the rest of this module does not need scikit-learn.
    from sklearn.linear_model import lasso_path

    others = matrix[:, 1:] - matrix[:, 1:].mean(axis=0)
    scaled, centred = others / others.std(axis=0), target - target.mean()
    largest = np.abs(scaled.T @ centred).max() / len(target)
    penalties, weights, *_ = lasso_path(scaled, centred, alphas=largest * np.geomspace(1.0, 1e-5, 200))
    supports: dict[tuple[int, ...], float] = {}
    for penalty, column in zip(penalties, weights.T, strict=True):
        support = tuple(int(index) + 1 for index in np.flatnonzero(column))
        supports[0, *support] = float(penalty / largest)
        if support:
            supports[support] = float(penalty / largest)
    supports.setdefault(tuple(range(matrix.shape[1])), 0.0)
    return supports


def least_squares(matrix: Float[np.ndarray, "B k"], target: Float[np.ndarray, " B"]) -> Float[np.ndarray, " k"]:
    """Return the weights that minimise `|matrix w − target|²`."""
    return np.asarray(np.linalg.lstsq(matrix, target, rcond=None)[0], dtype=np.float64)


def fit(
    dataset: Dataset, axes: Float[np.ndarray, "B L 3"], families: Mapping[str, Sequence[str]]
) -> dict[str, FamilyFit]:
    """Fit every family to a dataset, given the unit axes of its links in base axes.

    The paper mirrors its data first; callers should do the same.
    """
    geometry = angles(axes, dataset.wind_b)
    force = parts(dataset.force_area_b, geometry.wind)
    fits = {}
    for family, members in families.items():
        links = [dataset.links.index(name) for name in members]
        fits[family] = fit_family(
            geometry.cos[:, links].ravel(),
            geometry.sin[:, links].ravel(),
            Parts(force.drag[:, links].ravel(), force.across[:, links].reshape(-1, 3)),
            geometry.normal[:, links].reshape(-1, 3),
            np.repeat(dataset.family, len(links)),
        )
    return fits


def predicted_areas(
    coefficients: Float[np.ndarray, "L 6"], axes: Float[np.ndarray, "B L 3"], wind_b: Float[np.ndarray, "B 3"]
) -> Float[np.ndarray, "B L 3"]:
    """Return the force areas [m²] of the axisymmetric model, base axes, from coefficients [m²], axes and winds."""
    geometry = angles(axes, wind_b)
    terms = zip(coefficients.T, MODEL_TERMS, strict=False)
    drag = np.asarray(sum(w * geometry.cos**i * geometry.sin**j for w, (i, j) in terms))
    normal = coefficients[:, 5] * geometry.sin * geometry.cos
    areas: Floats = drag[..., None] * geometry.wind + normal[..., None] * geometry.normal
    return areas


class Quality(NamedTuple):
    """Error measures of predicted areas."""

    mse: float
    """Mean squared error over rows, links and axes [m⁴]."""
    r2: float
    """Explained share of the variance of the 39 components."""


def quality(predicted_b: Float[np.ndarray, "B L 3"], dataset: Dataset) -> Quality:
    """Return the error measures of predicted areas [m²], base axes, on a dataset."""
    error = predicted_b - dataset.force_area_b
    variance = dataset.force_area_b.reshape(len(dataset), -1).var(axis=0).mean()
    mse = float(np.mean(error**2))
    return Quality(mse=mse, r2=float(1.0 - mse / variance))


def held_out_areas(
    dataset: Dataset, axes: Float[np.ndarray, "B L 3"], families: Mapping[str, Sequence[str]]
) -> Float[np.ndarray, "B L 3"]:
    """Return the force areas [m²] of every row, base axes, by the fit to the other postures."""
    areas = np.empty_like(dataset.force_area_b)
    for number in np.unique(dataset.family):
        out = dataset.family == number
        fits = fit(dataset.take(~out), axes[~out], families)
        areas[out] = predicted_areas(coefficients_of(fits, families, dataset.links), axes[out], dataset.wind_b[out])
    return areas


def coefficients_of(
    fits: Mapping[str, FamilyFit], families: Mapping[str, Sequence[str]], links: Sequence[str]
) -> Float[np.ndarray, "L 6"]:
    """Return the coefficients [m²] in the order of `links`."""
    family_of = {link: family for family, members in families.items() for link in members}
    return np.array([fits[family_of[link]].coefficients for link in links])


def _held_out_error(matrix: Floats, target: Floats, posture: Indices) -> float:
    """Mean squared error on each posture of the fit to all other postures."""
    gram, moment = matrix.T @ matrix, matrix.T @ target
    squares = 0.0
    for number in np.unique(posture):
        rows = posture == number
        own = matrix[rows]
        weights = np.linalg.lstsq(gram - own.T @ own, moment - own.T @ target[rows], rcond=None)[0]
        squares += float(np.sum((own @ weights - target[rows]) ** 2))
    return squares / len(target)
