"""Correction of a model's link forces by total forces and moments measured in the wind tunnel.

Left and right links share three numbers: factors on drag and on normal force, and an offset of the centre of force
along the link's axis. To first order totals are linear in them, so they are found by ridge regression with the penalty
that predicts left-out postures best. Reported is the error on postures used for neither.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from experiments.data.ironcub import LINKS, joint_position
from jax_aero.aero.dataset import Floats
from jax_aero.aero.posture import link_arms, link_axes
from jax_aero.body.robot import RobotModel

FAMILIES: dict[str, tuple[str, ...]] = {
    "head": ("head",),
    "trunk": ("chest", "root_link"),
    "chest turbines": ("chest_l_jet_turbine", "chest_r_jet_turbine"),
    "upper arms": ("l_upper_arm", "r_upper_arm"),
    "arm turbines": ("l_arm_jet_turbine", "r_arm_jet_turbine"),
    "upper legs": ("l_upper_leg", "r_upper_leg"),
    "lower legs": ("l_lower_leg", "r_lower_leg"),
}
KINDS = ("drag", "normal", "offset")
SIZES = np.array([0.2, 0.2, 0.05])
"""Sizes that ridge regression treats as equally large: factors [1], offset [m]."""
STRENGTHS = np.logspace(-3.0, 3.0, 13)
"""Penalties of the ridge regression, relative to the mean square of a point's normalised error."""


class Points(NamedTuple):
    """Data of a correction; the six components are total force area [m²] and moment volume [m³]."""

    columns: Floats
    """(N, 6, K) contribution of each number to the totals, times its size."""
    missing: Floats
    """(N, 6) measured minus modelled totals."""
    posture: Any
    """(N,) names of the postures."""

    def take(self, rows: Any) -> Points:
        """Return the selected points."""
        return Points(self.columns[rows], self.missing[rows], self.posture[rows])


def columns(robot: RobotModel, joint_position_deg: Floats, wind_b: Floats, areas: Floats) -> Floats:
    """Return the contribution of each family's numbers to the totals (N, 6, 3 F).

    Parameters
    ----------
    joint_position_deg
        (N, 19) [deg], order of `ironcub.JOINTS`.
    wind_b
        (N, 3) unit vectors of the air's motion, base axes.
    areas
        (N, 13, 3) the model's force areas, base axes [m²].
    """
    joints = joint_position(robot, joint_position_deg)
    arms, axes = link_arms(robot, joints), link_axes(robot, joints)
    drag = np.einsum("nlx,nx,ny->nly", areas, wind_b, wind_b)
    force = np.stack([drag, areas - drag, np.zeros_like(areas)], axis=2)
    moment = np.cross(arms[:, :, None], force)
    moment[:, :, 2] = np.cross(axes, areas)
    of_links = np.concatenate([force, moment], axis=-1) * SIZES[:, None]
    member = np.array([[link in family for link in LINKS] for family in FAMILIES.values()], dtype=float)
    found: Floats = np.einsum("fl,nlkc->ncfk", member, of_links).reshape(len(areas), 6, -1)
    return found


def numbers(points: Points) -> Floats:
    """Return the correction (K,) in units of `SIZES`, with the penalty that predicts left-out postures best."""
    size = _size(points)
    rows, right = points.columns / size[:, None], points.missing / size
    error = np.zeros(len(STRENGTHS))
    for posture in np.unique(points.posture):
        out = points.posture == posture
        found = _ridge(rows[~out], right[~out])
        error += np.sum((right[out] - np.einsum("nck,sk->snc", rows[out], found)) ** 2, axis=(1, 2))
    best: Floats = _ridge(rows, right)[np.argmin(error)]
    return best


def held_out_errors(points: Points, group: Any) -> Floats:
    """Return the errors (N, 6) of the corrected model, each group's with the correction from the other groups."""
    error = points.missing.copy()
    for name in np.unique(group):
        out = group == name
        error[out] -= points.columns[out] @ numbers(points.take(~out))
    return error


def _size(points: Points) -> Floats:
    """Return the root mean square of the missing totals (6,), for force and moment, by which errors are normalised."""
    square = np.mean(points.missing**2, axis=0).reshape(2, 3).mean(axis=1)
    return np.repeat(np.sqrt(square), 3)


def _ridge(rows: Floats, right: Floats) -> Floats:
    """Return the minimisers (S, K) of |right − rows θ|²/N + λ |θ|² for all `STRENGTHS` λ."""
    matrix = np.einsum("nck,ncj->kj", rows, rows) / len(rows)
    value, vector = np.linalg.eigh(matrix)
    turned = vector.T @ np.einsum("nck,nc->k", rows, right) / len(rows)
    found: Floats = (turned / (np.maximum(value, 0.0) + STRENGTHS[:, None])) @ vector.T
    return found
