"""Conversion of a dataset to training rows of a network, and of a network's outputs to force areas."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jax_aero.aero.dataset import Dataset, Floats
from jax_aero.aero.network import (
    LinkGeometry,
    Network,
    baseline_areas,
    features,
    from_base_axes,
    link_geometry,
    network_areas,
)
from jax_aero.body.robot import RobotModel
from jax_aero.types import Array

CHUNK = 1024
"""Rows evaluated together."""
POSTURES = 32
"""Postures whose geometry is computed together."""


class Samples(NamedTuple):
    """Inputs and targets of a network, in single precision."""

    x: Float[np.ndarray, "B x"]
    y: Float[np.ndarray, "B y"]
    """Force areas in the network's frame and layout, minus the baseline [m²]."""

    def take(self, rows: Any) -> Samples:
        """Return the selected rows."""
        return Samples(self.x[rows], self.y[rows])


def samples_of(network: Network, robot: RobotModel, dataset: Dataset) -> Samples:
    """Return features and targets of all rows.

    Rotating targets into link axes preserves sums of squares, so the error of a sample is that of the force areas.
    """
    return make_samples(network, robot, dataset.joint_position(robot), dataset.wind_b, dataset.force_area_b)


def make_samples(
    network: Network,
    robot: RobotModel,
    joint_position: Float[np.ndarray, "B n"],
    wind_b: Float[np.ndarray, "B 3"],
    force_area_b: Float[np.ndarray, "B L 3"] | None,
) -> Samples:
    """Return the features of joint positions [rad] and winds, and the targets of force areas [m²] if given."""
    areas = np.zeros((len(wind_b), robot.aero_links.count, 3)) if force_area_b is None else force_area_b
    with jax.enable_x64(True):
        x, y = _evaluate_in_chunks(_sample_rows, network, robot, joint_position, wind_b, areas)
    return Samples(x.astype(np.float32), y.astype(np.float32))


def predict_areas(network: Network, robot: RobotModel, dataset: Dataset) -> Float[np.ndarray, "B L 3"]:
    """Return the network's force areas [m²] for the rows of a dataset, base axes, in its present precision."""
    with jax.enable_x64(True):
        (areas,) = _evaluate_in_chunks(_area_rows, network, robot, dataset.joint_position(robot), dataset.wind_b)
    return np.asarray(areas, dtype=np.float64)


# Compiled once per architecture, since rows and postures come in chunks of fixed size.


@jax.jit
def _sample_rows(network: Network, wind: Array, joints: Array, geometry: LinkGeometry, areas: Array) -> Any:
    def features_and_targets(wind: Array, joints: Array, geometry: LinkGeometry, areas: Array) -> tuple[Array, Array]:
        x = features(network.blocks, wind, joints, geometry)
        if network.baseline is not None:
            areas = areas - baseline_areas(network.baseline, wind, geometry.axes)
        return x, from_base_axes(network.frame, network.layout, areas, geometry.rotations)

    return jax.vmap(features_and_targets)(wind, joints, geometry, areas)


@jax.jit
def _area_rows(network: Network, wind: Array, joints: Array, geometry: LinkGeometry) -> Any:
    return (jax.vmap(functools.partial(network_areas, network))(wind, joints, geometry),)


@jax.jit
def _geometries(robot: RobotModel, angles: Array) -> LinkGeometry:
    return jax.vmap(functools.partial(link_geometry, robot))(angles)


def posture_geometry(
    robot: RobotModel, joint_position: Float[np.ndarray, "B n"]
) -> tuple[LinkGeometry, Int[np.ndarray, " B"]]:
    """Return the geometry of the distinct postures among rows [rad], and each row's index among them."""
    postures, number = np.unique(joint_position, axis=0, return_inverse=True)
    parts = []
    with jax.enable_x64(True):
        for start in range(0, len(postures), POSTURES):
            angles = np.zeros((POSTURES, robot.n_joints))
            here = postures[start : start + POSTURES]
            angles[: len(here)] = here
            parts.append(jax.tree.map(np.asarray, _geometries(robot, angles)))
    whole: LinkGeometry = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
    return whole, np.asarray(number, dtype=np.int64).reshape(-1)


def chunks(*arrays: Any) -> Iterator[tuple[int, list[Any]]]:
    """Yield chunks of `CHUNK` rows with the number of valid rows; the last is padded with copies of its first row."""
    for start in range(0, len(arrays[0]), CHUNK):
        pieces = [array[start : start + CHUNK] for array in arrays]
        count = len(pieces[0])
        missing = CHUNK - count
        yield count, [np.concatenate([piece, np.repeat(piece[:1], missing, axis=0)]) for piece in pieces]


def _evaluate_in_chunks(
    evaluate: Any, network: Network, robot: RobotModel, joint_position: Floats, wind_b: Floats, *more: Any
) -> list[Any]:
    geometry, number = posture_geometry(robot, joint_position)
    parts = []
    for count, (wind, joints, at, *rest) in chunks(wind_b, joint_position[:, list(network.joints)], number, *more):
        here = jax.tree.map(lambda leaf, at=at: leaf[at], geometry)
        parts.append([np.asarray(out)[:count] for out in evaluate(network, wind, joints, here, *rest)])
    return [np.concatenate(column) for column in zip(*parts, strict=True)]
