"""Files of a learned policy; see `jax_aero.base.cards`."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.base import cards
from jax_aero.body.robot import RobotModel
from jax_aero.control.law.residual import Layer, Policy, PolicyResidual
from jax_aero.types import leaf

FORMAT = "flight-policy"


def _tensors(policy: Policy) -> dict[str, Any]:
    """Return the weights by name."""
    layers = {f"hidden.{number}": layer for number, layer in enumerate(policy.hidden)} | {"output": policy.output}
    named = {f"{name}.{part}": weights for name, layer in layers.items() for part, weights in layer._asdict().items()}
    return named | {"direct.weight": policy.direct}


def make_card(
    name: str, residual: PolicyResidual, robot: RobotModel, *, description: str, training: Mapping[str, Any]
) -> tuple[dict[str, Any], bytes]:
    """Return the card of a policy and the file of its weights, in single precision."""
    policy = residual.policy
    return cards.make_card(
        FORMAT,
        name,
        _tensors(policy),
        description=description,
        training=training,
        inputs={"features": list(residual.features), "scale": np.asarray(residual.scale).tolist()},
        output={
            "jets": list(robot.jets.names),
            "joints": list(robot.joint_names),
            "thrust_rate": float(residual.thrust_rate),
            "joint_velocity": float(residual.joint_velocity),
            "replaces": residual.replaces,
        },
        architecture={"hidden": [len(layer.bias) for layer in policy.hidden]},
    )


def save_policy(
    path: str | PathLike[str],
    residual: PolicyResidual,
    robot: RobotModel,
    *,
    description: str,
    training: Mapping[str, Any],
) -> dict[str, Any]:
    """Write the card to `path` (ending in .json) and the weights beside it; return the card."""
    target = cards.card_path(path)
    card, tensors = make_card(target.stem, residual, robot, description=description, training=training)
    cards.write_card(target, card, tensors)
    return card


def load_policy(path: str | PathLike[str], robot: RobotModel) -> PolicyResidual:
    """Read a card and its weights.

    Raises
    ------
    ConfigError
        If the content is invalid; the message names the file, the card's key or the tensor, its value and what was
        expected.
    """
    card = rust.read_policy(path, robot.jets.names, robot.joint_names)
    return PolicyResidual(
        policy=Policy(
            tuple(Layer(*map(leaf, layer)) for layer in card["hidden"]),
            Layer(*map(leaf, card["output"])),
            leaf(card["direct"]),
        ),
        features=card["features"],
        scale=leaf(card["scale"]),
        thrust_rate=leaf(card["thrust_rate"]),
        joint_velocity=leaf(card["joint_velocity"]),
        jets=robot.jets.count,
        replaces=card["replaces"],
    )
