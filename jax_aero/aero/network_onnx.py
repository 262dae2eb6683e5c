"""ONNX files of a network in the published layout: two inputs and one output, samples in columns.

    wind (3, B) unit vectors, joints (19, B) [deg]  ──►  areas (39, B) [m²]: 13 CdA, 13 ClA, 13 CsA

Only plain networks can be written: features `wind` and `joints`, base axes, one member, not symmetrised, no baseline.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from jax_aero.aero.network import Layer, Network, network_joints, raw_output
from jax_aero.robot import RobotModel

OPSET = 17
IR_VERSION = 8
PROBES = 8
TOLERANCE = 1e-5
"""Largest accepted difference between the network read and the file's own output, relative to the largest output."""
_ACTIVATIONS = {"Relu": "relu", "Tanh": "tanh", "Sigmoid": "silu"}


def export_onnx(path: str | PathLike[str], network: Network) -> None:
    """Write a network as ONNX in single precision, with scale and offset merged into the last layer.

    Raises
    ------
    ValueError
        If the layout cannot represent the network; the message names the reason.
    """
    wanted: dict[str, Any] = {"features": ("wind", "joints"), "frame": "base", "layout": "component", "members": 1}
    wanted |= {"mirror": False, "baseline": None}
    found: dict[str, Any] = {
        "features": network.blocks,
        "frame": network.frame,
        "layout": network.layout,
        "members": network.members,
    }
    found |= {"mirror": network.mirror is not None, "baseline": None if network.baseline is None else "axisymmetric"}
    for key, value in wanted.items():
        if found[key] != value:
            raise ValueError(f"`{key}` of the network is {found[key]!r}; the ONNX layout supports only {value!r}")
    constants: dict[str, Any] = {"to_turns": np.float32(1.0 / 180.0)}
    nodes = [
        helper.make_node("Mul", ["joints", "to_turns"], ["scaled_joints"]),
        helper.make_node("Concat", ["wind", "scaled_joints"], ["h0"], axis=0),
    ]
    last = len(network.layers) - 1
    for index, layer in enumerate(network.layers):
        weight, bias = np.asarray(layer.weight[0], np.float64), np.asarray(layer.bias[0], np.float64)
        if index == last:
            scale, offset = np.asarray(network.scale, np.float64), np.asarray(network.offset, np.float64)
            weight, bias = scale[:, None] * weight, scale * bias + offset
        constants |= {f"weight{index}": weight.astype(np.float32), f"bias{index}": bias[:, None].astype(np.float32)}
        out = "areas" if index == last else f"sum{index}"
        nodes.append(helper.make_node("MatMul", [f"weight{index}", f"h{index}"], [f"product{index}"]))
        nodes.append(helper.make_node("Add", [f"product{index}", f"bias{index}"], [out]))
        if index < last:
            nodes += _activation(network.activation, out, f"h{index + 1}")
    model = helper.make_model(
        helper.make_graph(
            nodes,
            "link_force_areas",
            [_port("wind", 3), _port("joints", len(network.joints))],
            [_port("areas", network.scale.shape[0])],
            [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    onnx.checker.check_model(model)
    onnx.save(model, path)


def import_onnx(path: str | PathLike[str], robot: RobotModel) -> Network:
    """Read a file of the published layout: a chain of affine layers and activations.

    The layers are read from the graph in order. The result is then compared with the graph on random inputs, so a graph
    that computes anything else is refused.

    Raises
    ------
    ValueError
        If inputs, layers or activations differ from the layout, or if the network does not reproduce the file.
    """
    model = onnx.load(path)
    onnx.checker.check_model(model)
    graph = model.graph
    joints = network_joints(robot)
    constants = {item.name: numpy_helper.to_array(item) for item in graph.initializer}
    ports = [(port.name, _rows(port)) for port in graph.input if port.name not in constants]
    outputs = [_rows(port) for port in graph.output]
    size = 3 * robot.aero_links.count
    if [rows for _, rows in ports] != [3, len(joints)] or outputs != [size]:
        raise ValueError(f"ports are {ports} to {outputs}; expected (3, B) and ({len(joints)}, B) to ({size}, B)")
    kinds = {_ACTIVATIONS[node.op_type] for node in graph.node if node.op_type in _ACTIVATIONS}
    if len(kinds) > 1:
        raise ValueError(f"activations are {sorted(kinds)}; expected one kind")
    network = Network(
        blocks=("wind", "joints"),
        frame="base",
        layout="component",
        activation=kinds.pop() if kinds else "relu",  # type: ignore[arg-type]  # one of the values of _ACTIVATIONS
        joints=joints,
        layers=_layers(graph, constants, 3 + len(joints), size),
        scale=jnp.ones(size, jnp.float32),
        offset=jnp.zeros(size, jnp.float32),
        mirror=None,
        baseline=None,
    )
    _compare(model, network, [name for name, _ in ports])
    return network


def _activation(kind: str, source: str, target: str) -> list[Any]:
    if kind == "silu":
        gate = f"{target}_gate"
        return [helper.make_node("Sigmoid", [source], [gate]), helper.make_node("Mul", [source, gate], [target])]
    return [helper.make_node({"relu": "Relu", "tanh": "Tanh"}[kind], [source], [target])]


def _port(name: str, rows: int) -> Any:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [rows, "B"])


def _rows(port: Any) -> int:
    dimensions = port.type.tensor_type.shape.dim
    return int(dimensions[0].dim_value) if len(dimensions) else 0


def _layers(graph: Any, constants: dict[str, Any], size: int, last: int) -> tuple[Layer, ...]:
    layers: list[Layer] = []
    nodes = list(graph.node)
    for index, node in enumerate(nodes):
        if node.op_type not in ("MatMul", "Gemm"):
            continue
        weight = next((constants[name] for name in node.input if name in constants and constants[name].ndim == 2), None)
        if weight is None:
            raise ValueError(f"node `{node.name or node.output[0]}` multiplies without a constant matrix")
        if weight.shape[1] != size or (weight.shape[0] == size and _is_transposed(node, constants)):
            weight = weight.T
        if weight.shape[1] != size:
            raise ValueError(f"layer {len(layers)} has a weight of shape {weight.shape}; expected {size} inputs")
        size = weight.shape[0]
        names = list(node.input[2:]) if node.op_type == "Gemm" else []
        following = nodes[index + 1] if index + 1 < len(nodes) else None
        if not names and following is not None and following.op_type == "Add":
            names = [name for name in following.input if name in constants]
        bias = constants[names[0]].reshape(-1) if names else np.zeros(size)
        if bias.shape != (size,):
            raise ValueError(f"layer {len(layers)} has {bias.size} biases; expected {size}")
        parts = (jnp.asarray(np.array(value, dtype=np.float32))[None] for value in (weight, bias))
        layers.append(Layer(*parts))
    if not layers or size != last:
        raise ValueError(f"the last of {len(layers)} layers has {size} outputs; expected {last}")
    return tuple(layers)


def _is_transposed(node: Any, constants: dict[str, Any]) -> bool:
    """Whether a square matrix is the right operand and not transposed: then it is the transpose of our weight."""
    turns = {attribute.name: attribute.i for attribute in node.attribute}
    return node.input[1] in constants and not turns.get("transB", 0)


def _compare(model: Any, network: Network, names: list[str]) -> None:
    rng = np.random.default_rng(0)
    wind = rng.normal(size=(3, PROBES))
    wind = (wind / np.linalg.norm(wind, axis=0)).astype(np.float32)
    joints = rng.uniform(-40.0, 40.0, size=(len(network.joints), PROBES)).astype(np.float32)
    (theirs,) = ReferenceEvaluator(model).run(None, dict(zip(names, (wind, joints), strict=True)))
    x = jnp.asarray(np.concatenate([wind, joints / np.float32(180.0)]).T)
    ours = np.asarray(jax.vmap(lambda row: raw_output(network, row))(x)).T
    error = float(np.max(np.abs(np.asarray(theirs) - ours)) / np.max(np.abs(ours)))
    if not error < TOLERANCE:
        raise ValueError(f"read as layers, the file is off by {error:.1e} of its largest output; it is no such network")
