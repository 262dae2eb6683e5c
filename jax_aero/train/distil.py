"""Distillation: one network that approximates the mean of several at the cost of one evaluation."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from jax_aero.aero.dataset import Dataset, reorder_joints
from jax_aero.aero.network import Network, raw_output
from jax_aero.body.robot import RobotModel
from jax_aero.train.samples import Samples, chunks, make_samples
from jax_aero.types import Array


def distil_samples(
    teachers: Sequence[Network],
    robot: RobotModel,
    dataset: Dataset,
    *,
    count: int,
    spread_deg: float,
    seed: int,
) -> Samples:
    """Return samples whose targets are the teachers' mean, for the dataset's rows and `count` synthetic ones.

    Synthetic postures lie between two of the dataset's, in the same proportion for every joint, with normal deviations
    of `spread_deg` [deg]; their winds have random directions. The data's own targets and their noise are not used.
    """
    rng = np.random.default_rng(seed)
    postures = np.unique(dataset.joint_position_deg, axis=0)
    joints, wind = made_up(rng, postures, count, spread_deg)
    joints = np.concatenate([dataset.joint_position_deg, joints])
    wind = np.concatenate([dataset.wind_b, wind])
    x = make_samples(teachers[0], robot, reorder_joints(robot.joint_names, dataset.joints, joints), wind, None).x
    total = np.zeros((len(x), teachers[0].scale.shape[0]))
    for network in teachers:
        total += np.concatenate([np.asarray(_raw_rows(network, rows))[:count] for count, (rows,) in chunks(x)])
    return Samples(x, (total / len(teachers)).astype(np.float32))


def made_up(
    rng: np.random.Generator, postures: Float[np.ndarray, "k s"], count: int, spread_deg: float
) -> tuple[Float[np.ndarray, "count s"], Float[np.ndarray, "count 3"]]:
    """Return synthetic joint angles [deg] between those of postures, and unit winds."""
    first, second = rng.integers(len(postures), size=(2, count))
    part = rng.uniform(size=(count, 1))
    joints = part * postures[first] + (1.0 - part) * postures[second]
    joints = joints + rng.normal(scale=spread_deg, size=joints.shape)
    wind = rng.normal(size=(count, 3))
    return joints, wind / np.linalg.norm(wind, axis=1, keepdims=True)


@jax.jit
def _raw_rows(network: Network, x: Array) -> Array:
    return jax.vmap(functools.partial(raw_output, network))(x)
