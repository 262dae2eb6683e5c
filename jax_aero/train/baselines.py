"""Baselines for a network: the axisymmetric models, nearest neighbours, and a linear map."""

from __future__ import annotations

import jax
import numpy as np
from scipy.spatial import KDTree

from jax_aero.aero.dataset import Dataset, Floats
from jax_aero.aero.network import init_network
from jax_aero.body.robot import RobotModel
from jax_aero.train.loss import mean_square
from jax_aero.train.samples import samples_of

AXISYMMETRIC = ("published", "corrected", "signed", "estimated")
"""Coefficient sets that are shown, where a robot has them."""
NEIGHBOURS = 4


def baseline_errors(robot: RobotModel, training: Dataset, validation: Dataset) -> dict[str, float]:
    """Return mean squared errors [m⁴] of the validation rows, summed over components, by model.

    `nearest` is the mean of the four nearest training rows, weighted by the inverse distance in wind (unit vector) and
    joints (degrees / 180); `linear` is a least-squares map from the same 22 numbers.
    """
    sets = [name for name in AXISYMMETRIC if name in robot.aero_links.coefficients]
    errors = {f"axisymmetric, {name}": _axisymmetric(robot, name, validation) for name in sets}
    x, y = _inputs_and_targets(training)
    x_new, y_new = _inputs_and_targets(validation)
    distance, index = KDTree(x).query(x_new, k=NEIGHBOURS)
    weight = 1.0 / (distance + 1e-6)
    nearest = (y[index] * weight[..., None]).sum(axis=1) / weight.sum(axis=1, keepdims=True)
    errors["nearest"] = mean_square(nearest - y_new)
    ones = np.ones((len(x), 1))
    solution = np.linalg.lstsq(np.hstack([x, ones]), y, rcond=None)[0]
    linear = np.hstack([x_new, np.ones((len(x_new), 1))]) @ solution
    return errors | {"linear": mean_square(linear - y_new)}


def _inputs_and_targets(dataset: Dataset) -> tuple[Floats, Floats]:
    x = np.hstack([dataset.wind_b, dataset.joint_position_deg / 180.0])
    return x, dataset.force_area_b.reshape(len(dataset), -1)


def _axisymmetric(robot: RobotModel, coefficients: str, dataset: Dataset) -> float:
    rows = robot.aero_links.coefficients[coefficients]
    bare = init_network(jax.random.key(0), robot, hidden=(), blocks=("wind",), baseline=rows)
    left = samples_of(bare, robot, dataset).y.astype(np.float64)
    return mean_square(left)
