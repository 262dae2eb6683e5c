"""Files of a trained network: weights as `NAME.safetensors` with their card `NAME.json` beside them.

The card states inputs, outputs and their axes, architecture, training data and errors. The Rust crate and this module
read the same two files and refuse unknown content.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import jax
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as parse_tensors
from safetensors.numpy import save as dump_tensors

from jax_aero import tables
from jax_aero.aero.network import (
    BLOCKS,
    Activation,
    Block,
    Frame,
    Layer,
    Layout,
    Network,
    check_output,
    layer_sizes,
    mirror_of,
    network_joints,
)
from jax_aero.command import ConfigError
from jax_aero.files import read_bytes, read_text, write_bytes, write_text
from jax_aero.robot import RobotModel
from jax_aero.types import Array

T = TypeVar("T")

FORMAT = "flight-aero-network"
VERSION = 1


class Weights(tables.Table, frozen=True):
    """File of the weights."""

    file: str
    sha256: str

    def __post_init__(self) -> None:
        if Path(self.file).name != self.file:
            raise ConfigError.of("file", self.file, "a file's name, beside the card")


class Inputs(tables.Table, frozen=True):
    """Inputs of the network."""

    features: tuple[Block, ...]
    joints: tuple[str, ...]
    links: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.features or len(set(self.features)) < len(self.features):
            raise ConfigError.of("features", self.features, f"some of {', '.join(BLOCKS)}, each once")


class Output(tables.Table, frozen=True):
    """Outputs of the network and their axes."""

    frame: Frame
    layout: Layout
    unit: Literal["m^2"]

    def __post_init__(self) -> None:
        check_output(self.frame, self.layout)


class Coefficients(tables.Table, frozen=True):
    """Coefficients of the axisymmetric model of a link [m²]."""

    cda: tuple[float, float, float, float, float]
    cna: float


class Baseline(tables.Table, frozen=True):
    """Model that the network corrects."""

    kind: Literal["axisymmetric"]
    links: dict[str, Coefficients]


class Architecture(tables.Table, frozen=True):
    """Architecture of the network."""

    hidden: tuple[tables.Count, ...]
    activation: Activation
    members: tables.Count
    mirror: bool
    baseline: Baseline | None = None


class Card(tables.Table, frozen=True):
    """Description of a network, except its weights."""

    format: Literal["flight-aero-network"]
    version: Literal[1]
    name: str
    description: str
    weights: Weights
    inputs: Inputs
    output: Output
    architecture: Architecture
    training: dict[str, Any]


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
    tensors = dump_tensors(_tensors(network))
    card = {
        "format": FORMAT,
        "version": VERSION,
        "name": target.stem,
        "description": description,
        "weights": {"file": f"{target.stem}.safetensors", "sha256": hashlib.sha256(tensors).hexdigest()},
        "inputs": {
            "features": list(network.blocks),
            "joints": [robot.joint_names[joint] for joint in network.joints],
            "links": list(robot.aero_links.names),
        },
        "output": {"frame": network.frame, "layout": network.layout, "unit": "m^2"},
        "architecture": {
            "hidden": list(network.hidden),
            "activation": network.activation,
            "members": network.members,
            "mirror": network.mirror is not None,
            "baseline": _baseline_table(network.baseline, robot.aero_links.names),
        },
        "training": dict(training),
    }
    write_card(target, card, tensors)
    return card


def copy_network(source: str | PathLike[str], path: str | PathLike[str]) -> None:
    """Copy a network's card and weights to the name of `path` (ending in .json)."""
    target, origin = card_path(path), Path(source)
    card = json.loads(read_text(origin))
    tensors = read_bytes(origin.with_name(card["weights"]["file"]))
    weights = {**card["weights"], "file": f"{target.stem}.safetensors"}
    write_card(target, {**card, "name": target.stem, "weights": weights}, tensors)


def card_path(path: str | PathLike[str]) -> Path:
    """Return the path of a card; refuse one that does not end in .json."""
    target = Path(path)
    if target.suffix != ".json":
        raise ValueError(f"path is {target.name!r}; expected the card's name, ending in .json")
    return target


def write_card(target: Path, card: Mapping[str, Any], tensors: bytes) -> None:
    """Write a card and, beside it, its weights."""
    text = card_text(card)  # refused before anything is written
    # Weights first: a card never names missing weights, and an old card refuses new weights by their hash.
    write_bytes(target.with_suffix(".safetensors"), tensors)
    write_text(target, text)


def card_text(card: Mapping[str, Any]) -> str:
    """Return the content of a card's file."""
    return f"{json.dumps(card, indent=2, ensure_ascii=False, allow_nan=False)}\n"


def load_network(path: str | PathLike[str], robot: RobotModel) -> Network:
    """Read a card and its weights, in single precision.

    Raises
    ------
    ValueError
        If the content is invalid; the message names the card's key or the tensor, its value and what was expected:
        unknown or missing keys, another format, joints or links that differ from the robot's, weights of another hash
        or shape, numbers that are not finite.
    """
    card = read_card(path)
    joints = network_joints(robot)
    expect("inputs.joints", list(card.inputs.joints), [robot.joint_names[joint] for joint in joints])
    expect("inputs.links", list(card.inputs.links), list(robot.aero_links.names))
    blocks, output, shape = card.inputs.features, card.output, card.architecture
    tensors = read_tensors(Path(path).parent / card.weights.file, card.weights.sha256)
    layers, scale, offset = _layers(tensors, layer_sizes(robot, blocks, shape.hidden), shape.members)
    return Network(
        blocks=blocks,
        frame=output.frame,
        layout=output.layout,
        activation=shape.activation,
        joints=joints,
        layers=layers,
        scale=scale,
        offset=offset,
        mirror=mirror_of(robot, blocks, output.layout, output.frame) if shape.mirror else None,
        baseline=_baseline_rows(shape.baseline, robot.aero_links.names),
    )


def read_card(path: str | PathLike[str]) -> Card:
    """Read a card, with all checks that need neither a robot nor the weights."""
    return read_table(path, Card)


def read_table(path: str | PathLike[str], kind: type[T]) -> T:
    """Read a card of this type."""
    origin = f"card {Path(path).name}"
    try:
        # A null key counts as missing.
        card = json.loads(read_text(Path(path)), object_pairs_hook=_with_values)
    except (ValueError, RecursionError) as reason:
        raise ValueError(f"{origin}: no JSON: {reason}") from None
    return tables.convert(card, kind, origin)


def _with_values(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    return {key: value for key, value in pairs if value is not None}


def expect(key: str, value: Any, expected: Any) -> None:
    """Refuse another value of a card's key."""
    if value != expected:
        raise ValueError(f"`{key}` is {value!r}; expected {expected!r}")


def _tensors(network: Network) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for member in range(network.members):
        for index, layer in enumerate(network.layers):
            prefix = f"member.{member}.layer.{index}"
            named[f"{prefix}.weight"], named[f"{prefix}.bias"] = layer.weight[member], layer.bias[member]
    named |= {"output.scale": network.scale, "output.offset": network.offset}
    tensors = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in named.items()}
    for name, value in tensors.items():
        check_finite(name, value)
    return tensors


def read_tensors(path: Path, sha256: str) -> dict[str, Any]:
    """Return the tensors of a file with this hash, by name."""
    content = read_bytes(path)
    expect("weights.sha256", sha256, hashlib.sha256(content).hexdigest())
    try:
        return parse_tensors(content)
    except (SafetensorError, KeyError) as reason:
        raise ValueError(f"{path.name}: no safetensors file: {reason}") from None


def _layers(tensors: dict[str, Any], sizes: Sequence[int], members: int) -> tuple[tuple[Layer, ...], Array, Array]:
    shapes: dict[str, tuple[int, ...]] = {"output.scale": (sizes[-1],), "output.offset": (sizes[-1],)}
    for index, (narrow, wide) in enumerate(itertools.pairwise(sizes)):
        for member in range(members):
            shapes[f"member.{member}.layer.{index}.weight"] = (wide, narrow)
            shapes[f"member.{member}.layer.{index}.bias"] = (wide,)
    if unknown := set(tensors) - set(shapes):
        raise ValueError(f"unknown tensors {sorted(unknown)}")
    for name, shape in shapes.items():
        if name not in tensors:
            raise ValueError(f"tensor `{name}` is missing")
        if tensors[name].shape != shape or tensors[name].dtype != np.float32:
            found = f"{tensors[name].dtype} of shape {tensors[name].shape}"
            raise ValueError(f"tensor `{name}` is {found}; expected float32 of shape {shape}")
        check_finite(name, tensors[name])
    layers = tuple(
        Layer(
            *(
                jax.numpy.asarray(np.stack([tensors[f"member.{k}.layer.{index}.{part}"] for k in range(members)]))
                for part in ("weight", "bias")
            )
        )
        for index in range(len(sizes) - 1)
    )
    return layers, jax.numpy.asarray(tensors["output.scale"]), jax.numpy.asarray(tensors["output.offset"])


def check_finite(name: str, value: Any) -> None:
    """Refuse a tensor with a number that is not finite."""
    if not np.isfinite(value).all():
        place = tuple(int(index) for index in np.argwhere(~np.isfinite(value))[0])
        raise ValueError(f"tensor `{name}` is {value[place]} at {place}; expected finite numbers")


def _baseline_table(rows: Array | None, names: Sequence[str]) -> dict[str, Any] | None:
    if rows is None:
        return None
    links = {
        name: {"cda": [float(w) for w in row[:5]], "cna": float(row[5])}
        for name, row in zip(names, np.asarray(rows, dtype=np.float64), strict=True)
    }
    return {"kind": "axisymmetric", "links": links}


def _baseline_rows(baseline: Baseline | None, names: Sequence[str]) -> Array | None:
    if baseline is None:
        return None
    expect("architecture.baseline.links", sorted(baseline.links), sorted(names))
    rows = [baseline.links[name] for name in names]
    return cast(Array, np.array([[*row.cda, row.cna] for row in rows]))
