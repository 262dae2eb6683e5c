"""Files of a learned policy: weights as `NAME.safetensors` with their card `NAME.json` beside them.

The card states what the policy observes and acts on, its size, and task and record of its training. The Rust crate and
this module read the same two files and refuse unknown content.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from safetensors.numpy import save as dump_tensors

from jax_aero import tables
from jax_aero.aero.network_card import (
    Weights,
    card_path,
    check_finite,
    expect,
    read_table,
    read_tensors,
    write_card,
)
from jax_aero.command import ConfigError
from jax_aero.control.law.residual import Policy, PolicyResidual
from jax_aero.robot import RobotModel
from jax_aero.types import leaf

FORMAT = "flight-policy"
VERSION = 1

Feature = Literal["gravity", "rotation", "position", "velocity", "angular_velocity", "force", "moment"]


TENSORS = {
    "hidden.weight": "hidden",
    "hidden.bias": "hidden_bias",
    "output.weight": "output",
    "direct.weight": "direct",
    "output.bias": "output_bias",
}
"""Fields of the weights, by name of the tensor."""


class Inputs(tables.Table, frozen=True):
    """What the policy observes."""

    features: Annotated[tuple[Feature, ...], msgspec.Meta(min_length=1)]
    scale: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(set(self.features)) < len(self.features):
            raise ConfigError.of("features", self.features, "each once")
        if len(self.scale) != len(self.features):
            raise ConfigError.of("scale", self.scale, "one number for each feature")


class Output(tables.Table, frozen=True):
    """What the policy acts on."""

    jets: tuple[str, ...]
    joints: tuple[str, ...]
    thrust_rate: tables.NonNegative
    joint_velocity: tables.NonNegative


class Architecture(tables.Table, frozen=True):
    """Layers of the policy."""

    hidden: tables.Count


class Card(tables.Table, frozen=True):
    """Description of a policy, except its weights."""

    format: Literal["flight-policy"]
    version: Literal[1]
    name: str
    description: str
    weights: Weights
    inputs: Inputs
    output: Output
    architecture: Architecture
    training: dict[str, Any]


def make_card(
    name: str, residual: PolicyResidual, robot: RobotModel, *, description: str, training: Mapping[str, Any]
) -> tuple[dict[str, Any], bytes]:
    """Return the card of a policy and the file of its weights, in single precision."""
    policy = residual.policy
    arrays = {key: np.ascontiguousarray(getattr(policy, of), dtype=np.float32) for key, of in TENSORS.items()}
    for key, value in arrays.items():
        check_finite(key, value)
    tensors = dump_tensors(arrays)
    card = {
        "format": FORMAT,
        "version": VERSION,
        "name": name,
        "description": description,
        "weights": {"file": f"{name}.safetensors", "sha256": hashlib.sha256(tensors).hexdigest()},
        "inputs": {"features": list(residual.features), "scale": np.asarray(residual.scale).tolist()},
        "output": {
            "jets": list(robot.jets.names),
            "joints": list(robot.joint_names),
            "thrust_rate": float(residual.thrust_rate),
            "joint_velocity": float(residual.joint_velocity),
        },
        "architecture": {"hidden": len(policy.hidden_bias)},
        "training": dict(training),
    }
    return card, tensors


def save_policy(
    path: str | PathLike[str],
    residual: PolicyResidual,
    robot: RobotModel,
    *,
    description: str,
    training: Mapping[str, Any],
) -> dict[str, Any]:
    """Write the card to `path` (ending in .json) and the weights beside it; return the card."""
    target = card_path(path)
    card, tensors = make_card(target.stem, residual, robot, description=description, training=training)
    write_card(target, card, tensors)
    return card


def load_policy(path: str | PathLike[str], robot: RobotModel) -> PolicyResidual:
    """Read a card and its weights.

    Raises
    ------
    ValueError
        If the content is invalid; the message names the card's key or the tensor, its value and what was expected:
        unknown or missing keys, another format, jets or joints that differ from the robot's, weights of another hash or
        shape, numbers that are not finite.
    """
    card = read_table(path, Card)
    inputs, output = card.inputs, card.output
    expect("output.jets", list(output.jets), list(robot.jets.names))
    expect("output.joints", list(output.joints), list(robot.joint_names))
    tensors = read_tensors(Path(path).parent / card.weights.file, card.weights.sha256)
    units, seen, actions = card.architecture.hidden, 3 * len(inputs.features), len(output.jets) + len(output.joints)
    shapes = ((units, seen), (units,), (actions, units), (actions, seen), (actions,))
    expect("tensors", sorted(tensors), sorted(TENSORS))
    for name, shape in zip(TENSORS, shapes, strict=True):
        found = tensors[name]
        if found.shape != shape or found.dtype != np.float32:
            raise ValueError(
                f"tensor `{name}` is {found.dtype} of shape {found.shape}; expected float32 of shape {shape}"
            )
        check_finite(name, found)
    return PolicyResidual(
        policy=Policy(**{field: leaf(tensors[name]) for name, field in TENSORS.items()}),
        features=inputs.features,
        scale=leaf(inputs.scale),
        thrust_rate=leaf(output.thrust_rate),
        joint_velocity=leaf(output.joint_velocity),
        jets=len(output.jets),
    )
