"""ONNX in the published layout: there and back, and beside an independent runtime."""

import dataclasses

import jax
import numpy as np
import onnx
import pytest

from jax_aero.aero.network import init_network, raw_output
from jax_aero.aero.network_onnx import export_onnx, import_onnx


def answers(network, wind, joints):
    x = np.concatenate([wind, joints / np.float32(180.0)]).T
    return np.asarray(jax.vmap(lambda row: raw_output(network, row))(x)).T


@pytest.fixture
def inputs():
    rng = np.random.default_rng(2)
    wind = rng.normal(size=(3, 7)).astype(np.float32)
    return wind / np.linalg.norm(wind, axis=0), rng.uniform(-60, 60, size=(19, 7)).astype(np.float32)


@pytest.mark.parametrize("activation", ["relu", "tanh", "silu"])
def test_a_network_goes_there_and_back(ironcub, tmp_path, inputs, activation):
    onnxruntime = pytest.importorskip("onnxruntime")
    # A hidden layer as wide as the input, and one as wide as the output: shapes alone do not distinguish them.
    network = init_network(jax.random.key(1), ironcub, hidden=(22, 22, 39), activation=activation)
    path = tmp_path / "network.onnx"
    export_onnx(path, network)
    expected = answers(network, *inputs)
    np.testing.assert_allclose(answers(import_onnx(path, ironcub), *inputs), expected, rtol=0.0, atol=1e-6)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (theirs,) = session.run(None, dict(zip(("wind", "joints"), inputs, strict=True)))
    np.testing.assert_allclose(theirs, expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({"mirror": True}, "`mirror` of the network is True"),
        ({"members": 2}, "`members` of the network is 2"),
        ({"blocks": ("wind", "link_wind")}, "`features` of the network is"),
        ({"frame": "link", "layout": "link"}, "`frame` of the network is 'link'"),
    ],
)
def test_what_the_layout_cannot_represent_is_refused(ironcub, tmp_path, shape, message):
    network = init_network(jax.random.key(1), ironcub, hidden=(4,), **shape)
    with pytest.raises(ValueError, match=message):
        export_onnx(tmp_path / "network.onnx", network)
    assert not (tmp_path / "network.onnx").exists()


def test_a_graph_that_does_more_is_refused_and_not_misread(ironcub, tmp_path):
    path = tmp_path / "network.onnx"
    export_onnx(path, init_network(jax.random.key(1), ironcub, hidden=(4,)))
    model = onnx.load(path)
    last = model.graph.node[-1]
    last.output[0] = "almost"
    model.graph.node.append(onnx.helper.make_node("Abs", ["almost"], ["areas"]))
    onnx.save(model, path)
    with pytest.raises(ValueError, match="the file is off by"):
        import_onnx(path, ironcub)


def test_a_layer_without_biases_has_none(ironcub, tmp_path, inputs):
    path = tmp_path / "network.onnx"
    network = init_network(jax.random.key(1), ironcub, hidden=(4,))
    *layers, last = network.layers
    biased = dataclasses.replace(network, layers=(*layers, dataclasses.replace(last, bias=last.bias + 1.0)))
    export_onnx(path, biased)
    model = onnx.load(path)
    model.graph.node.pop()
    model.graph.node[-1].output[0] = "areas"
    onnx.save(model, path)
    expected = answers(biased, *inputs) - biased.layers[-1].bias[0][:, None]
    np.testing.assert_allclose(answers(import_onnx(path, ironcub), *inputs), expected, rtol=0.0, atol=1e-6)


def test_other_ports_are_refused(ironcub, tmp_path):
    path = tmp_path / "network.onnx"
    export_onnx(path, init_network(jax.random.key(1), ironcub, hidden=(4,)))
    model = onnx.load(path)
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 4
    onnx.save(model, path)
    with pytest.raises(ValueError, match=r"ports are .*'wind', 4.*expected \(3, B\)"):
        import_onnx(path, ironcub)
