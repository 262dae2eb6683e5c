"""Files of a trained network; see `jax_aero.base.cards`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import jax.numpy as jnp
import numpy as np

from jax_aero import rust
from jax_aero.aero.network import Layer, Network, mirror_of
from jax_aero.base.cards import card_path, make_card, write_card
from jax_aero.body.robot import RobotModel
from jax_aero.types import Array

FORMAT = "flight-aero-network"


def save_network(
    path: str | PathLike[str],
    network: Network,
    robot: RobotModel,
    *,
    description: str,
    training: Mapping[str, Any],
) -> dict[str, Any]:
    """Write the card to `path` (ending in .json) and the weights beside it, in single precision; return the card."""
    target = card_path(path)
    tensors: dict[str, Any] = {}
    for member in range(network.members):
        for index, layer in enumerate(network.layers):
            prefix = f"member.{member}.layer.{index}"
            tensors |= {f"{prefix}.weight": layer.weight[member], f"{prefix}.bias": layer.bias[member]}
    tensors |= {"output.scale": network.scale, "output.offset": network.offset}
    card, content = make_card(
        FORMAT,
        target.stem,
        tensors,
        description=description,
        training=training,
        inputs={
            "features": list(network.blocks),
            "joints": [robot.joint_names[joint] for joint in network.joints],
            "links": list(robot.aero_links.names),
        },
        output={"frame": network.frame, "layout": network.layout, "unit": "m^2"},
        architecture={
            "hidden": list(network.hidden),
            "activation": network.activation,
            "members": network.members,
            "mirror": network.mirror is not None,
            "baseline": _baseline_table(network.baseline, robot.aero_links.names),
        },
    )
    write_card(target, card, content)
    return card


def _baseline_table(rows: Array | None, names: Sequence[str]) -> dict[str, Any] | None:
    if rows is None:
        return None
    numbers = np.asarray(rows, dtype=np.float64).tolist()
    links = {name: {"cda": cda, "cna": cna} for name, (*cda, cna) in zip(names, numbers, strict=True)}
    return {"kind": "axisymmetric", "links": links}


def load_network(path: str | PathLike[str], robot: RobotModel) -> Network:
    """Read a card and its weights, in single precision.

    Raises
    ------
    ConfigError
        If the content is invalid; the message names the file, the card's key or the tensor, its value and what was
        expected.
    """
    card = rust.read_network(path, robot.joint_names, robot.aero_links.names)
    layers = tuple(Layer(jnp.asarray(weight), jnp.asarray(bias)) for weight, bias in card.pop("layers"))
    scale, offset = (jnp.asarray(card.pop(part)) for part in ("scale", "offset"))
    of = [card[key] for key in ("joints", "blocks", "layout", "frame")]
    mirror = mirror_of(robot, *of) if card.pop("mirror") else None
    return Network(**card, layers=layers, scale=scale, offset=offset, mirror=mirror)
