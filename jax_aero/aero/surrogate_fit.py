"""Fit of the panel model's coefficients to published data alone: drag curves of links and tables of the whole robot.

    minimise  Σ_links Σ_winds w_l (F_l·w − C_D A_l(α))² + Σ_records |Σ_l F_l − F|²/σ_F² + λ₀ |b₀|² + λ Σ_f |b_f − b₀|²

The curves determine the drag of each link, the records the force on the whole robot, including its direction. Since the
records contain only the sum over families, the last term keeps the families near a common pressure law b₀. The
penalties are chosen by leaving out one posture's records at a time.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jax_aero.aero.dataset import LINKS, Floats, tunnel_from_base, wind_direction
from jax_aero.aero.fit import FAMILIES, angles, drag_areas
from jax_aero.aero.posture import link_axes
from jax_aero.aero.surrogate import TERMS, Features
from jax_aero.robot import RobotModel

FAMILY_OF = np.array([next(i for i, members in enumerate(FAMILIES.values()) if link in members) for link in LINKS])
"""(13,) index of each link's family."""

N_FAMILIES, N_TERMS = len(FAMILIES), len(TERMS)


@dataclass(frozen=True)
class Records:
    """Measured or computed forces on the whole robot."""

    posture: tuple[str, ...]
    joint_position_deg: Float[np.ndarray, "k s"]
    pitch_deg: Float[np.ndarray, " k"]
    yaw_deg: Float[np.ndarray, " k"]
    force_area_w: Float[np.ndarray, "k 3"]
    """Drag, side and lift area [m²]."""

    @property
    def wind_b(self) -> Float[np.ndarray, "k 3"]:
        """Return the unit vectors of the air's motion, base axes."""
        return wind_direction(self.pitch_deg, self.yaw_deg)


class Settings(NamedTuple):
    """Weights of the terms of the fit."""

    force_error: float = 0.007
    """σ_F: combined error of the model and the records [m²]."""
    curve_error: float = 0.006
    """Scatter of a link's drag area about its curve [m²]."""
    curve_weight: float = 60.0
    """Number of independent points that a curve counts as."""
    to_common: float = 10.0
    """λ: penalty on deviations of a family from the common law."""
    to_zero: float = 0.1
    """λ₀: penalty on the common law."""


GRID: Mapping[str, tuple[float, ...]] = {
    "curve_weight": (6.0, 60.0, 600.0),
    "to_common": (1.0, 10.0, 100.0, 1000.0),
    "to_zero": (0.01, 0.1, 1.0),
}
"""Values tried by `choose`."""


class Normal(NamedTuple):
    """Normal equations `A b = y` of the weights b (8 × 12)."""

    matrix: Float[np.ndarray, "96 96"]
    right: Float[np.ndarray, "96"]


class Calibration(NamedTuple):
    """Precomputed terms of the fit."""

    curves: Normal
    """Normal equations of all curves, each counted as one point of unit error."""
    design: Float[np.ndarray, "k 3 96"]
    """Derivatives of the records' force areas in the tunnel frame with respect to the weights [m²]."""
    target: Float[np.ndarray, "k 3"]
    """Force areas of the records in the tunnel frame [m²]."""
    posture: tuple[str, ...]


def prepare(
    robot: RobotModel, coefficients: Float[np.ndarray, "L 6"], features: Features, records: Records
) -> Calibration:
    """Precompute the terms of the curves and records.

    Parameters
    ----------
    robot, coefficients
        The robot and the axisymmetric coefficients [m²] that define the drag curves of its links.
    features
        Features of the panel model, see `batched_features`.
    records
        Records whose postures are also those in which the curves are evaluated.
    """
    pitch, yaw = (grid.ravel() for grid in np.meshgrid(np.arange(0.0, 181.0, 20.0), np.arange(0.0, 181.0, 20.0)))
    shapes = np.unique(records.joint_position_deg, axis=0)
    joints, wind = np.repeat(shapes, len(pitch), axis=0), np.tile(wind_direction(pitch, yaw), (len(shapes), 1))
    geometry = angles(link_axes(robot, joints), wind)
    drag = drag_areas(coefficients, geometry)
    along = np.einsum("nlma,na->nlm", features(joints, wind), wind)
    size = N_FAMILIES * N_TERMS
    curves = Normal(np.zeros((size, size)), np.zeros(size))
    for link, family in enumerate(FAMILY_OF):
        own = slice(N_TERMS * family, N_TERMS * (family + 1))
        share = 1.0 / (len(wind) * len(FAMILIES[list(FAMILIES)[family]]))
        curves.matrix[own, own] += share * along[:, link].T @ along[:, link]
        curves.right[own] += share * along[:, link].T @ drag[:, link]
    turned = np.einsum(
        "nij,nlmj->nlim",
        tunnel_from_base(records.pitch_deg, records.yaw_deg),
        features(records.joint_position_deg, records.wind_b),
    )
    design = np.zeros((len(records.posture), 3, N_FAMILIES, N_TERMS))
    for link, family in enumerate(FAMILY_OF):
        design[:, :, family] += turned[:, link]
    return Calibration(curves, design.reshape(-1, 3, size), records.force_area_w, records.posture)


def solve(
    calibration: Calibration, settings: Settings, rows: Bool[np.ndarray, " k"] | None = None
) -> Float[np.ndarray, "8 12"]:
    """Return the weights of the families, fitted to the selected records or to all."""
    use = np.ones(len(calibration.target), dtype=bool) if rows is None else rows
    design = calibration.design[use].reshape(-1, N_FAMILIES * N_TERMS)
    weight = settings.curve_weight / settings.curve_error**2
    matrix = weight * calibration.curves.matrix + design.T @ design / settings.force_error**2
    right = weight * calibration.curves.right + design.T @ calibration.target[use].ravel() / settings.force_error**2
    # b = P (b₀, δ): every family has the common law plus its own deviation.
    common = np.tile(np.eye(N_TERMS), (N_FAMILIES, 1))
    spread = np.hstack([common, np.eye(N_FAMILIES * N_TERMS)])
    penalty = np.repeat([settings.to_zero, settings.to_common], [N_TERMS, N_FAMILIES * N_TERMS])
    weights: Floats = spread @ np.linalg.solve(spread.T @ matrix @ spread + np.diag(penalty), spread.T @ right)
    return weights.reshape(N_FAMILIES, N_TERMS)


def errors(calibration: Calibration, weights: Float[np.ndarray, "8 12"]) -> Float[np.ndarray, "k 3"]:
    """Return the model's force areas minus those of the records [m²]: drag, side, lift."""
    found: Floats = calibration.design @ weights.ravel() - calibration.target
    return found


def left_out_error(calibration: Calibration, settings: Settings) -> float:
    """Return the rms over postures of the rms error of a posture's records when they are left out of the fit [m²]."""
    squares = []
    for posture in dict.fromkeys(calibration.posture):
        own = np.array([name == posture for name in calibration.posture])
        off = errors(calibration, solve(calibration, settings, ~own))[own]
        squares.append(np.mean(np.sum(off**2, axis=1)))
    return float(np.sqrt(np.mean(squares)))


def choose(calibration: Calibration) -> tuple[Settings, dict[Settings, float]]:
    """Return the settings of `GRID` with the smallest error on left-out postures, and the errors of all settings."""
    tried = {}
    for values in itertools.product(*GRID.values()):
        settings = Settings()._replace(**dict(zip(GRID, values, strict=True)))
        tried[settings] = left_out_error(calibration, settings)
    return min(tried, key=lambda settings: tried[settings]), tried
