"""Weights and their card: what is read back, what is refused, and that the shipped ones answer as recorded."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import jax
import msgspec
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from jax_aero.aero.network import init_network, with_precision
from jax_aero.aero.network_card import load_network, read_card, save_network
from jax_aero.train.samples import predict_areas

SHIPPED = sorted((Path(__file__).parents[2] / "configs" / "aero" / "networks").glob("*.json"))


@pytest.fixture
def card(ironcub, tmp_path):
    rows = ironcub.aero_links.coefficients["signed"]
    network = init_network(
        jax.random.key(1),
        ironcub,
        hidden=(5, 4),
        blocks=("link_wind", "joints"),
        activation="silu",
        members=2,
        mirror=True,
        frame="link",
        layout="link",
        baseline=rows,
    )
    path = tmp_path / "small.json"
    save_network(path, network, ironcub, description="made up", training={"note": "not trained"})
    return path


def test_a_network_that_is_not_mirrored_needs_no_symmetric_robot(ironcub, tmp_path):
    links = ironcub.aero_links
    odd = replace(ironcub, aero_links=replace(links, names=("r_head", *links.names[1:])))
    network = init_network(jax.random.key(1), odd, hidden=(4,))
    save_network(tmp_path / "odd.json", network, odd, description="made up", training={})
    assert load_network(tmp_path / "odd.json", odd).mirror is None
    with pytest.raises(ValueError, match="`r_head` has no `l_head` opposite to it"):
        init_network(jax.random.key(1), odd, hidden=(4,), mirror=True)


def test_a_card_has_no_number_that_is_none(card, ironcub):
    """JSON has no NaN; a card that had one could not be read by others."""
    network = load_network(card, ironcub)
    with pytest.raises(ValueError, match="JSON compliant"):
        save_network(card, network, ironcub, description="made up", training={"mse": float("nan")})


def test_a_card_that_cannot_be_written_leaves_the_old_weights(card, ironcub):
    network = init_network(jax.random.key(2), ironcub, hidden=(5,))
    with pytest.raises(ValueError, match="JSON compliant"):
        save_network(card, network, ironcub, description="made up", training={"mse": float("nan")})
    assert load_network(card, ironcub).hidden == (5, 4)


def test_weights_whose_card_did_not_follow_are_recognised(card, ironcub, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    network = init_network(jax.random.key(2), ironcub, hidden=(5, 4))
    kept = card.with_name("kept")
    kept.hardlink_to(card.with_suffix(".safetensors"))
    before = kept.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr("jax_aero.aero.network_card.write_text", interrupt)
        with pytest.raises(KeyboardInterrupt):
            save_network(card, network, ironcub, description="made up", training={})
    with pytest.raises(ValueError, match=r"`weights\.sha256` is '"):
        load_network(card, ironcub)
    assert kept.read_bytes() == before  # who had them open still has all of them


def test_what_is_written_is_read_back(card, ironcub):
    network = load_network(card, ironcub)
    again = card.with_name("again.json")
    save_network(again, network, ironcub, description="made up", training={"note": "not trained"})
    assert again.with_suffix(".safetensors").read_bytes() == card.with_suffix(".safetensors").read_bytes()
    ours, theirs = read_card(card), read_card(again)
    assert (ours.name, theirs.name) == ("small", "again")
    assert ours.weights.sha256 == theirs.weights.sha256
    assert msgspec.structs.replace(theirs, name="small", weights=ours.weights) == ours
    assert network.parameters == 2 * (58 * 5 + 5 + 5 * 4 + 4 + 4 * 39 + 39)


def edit(card, key, value):
    document = json.loads(card.read_text())
    table = document
    *where, last = key.split(".")
    for word in where:
        table = table[word]
    if value is None:
        del table[last]
    else:
        table[last] = value
    card.write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("colour", "blue", "card small.json: unknown key `colour`"),
        ("inputs.scaling", 1.0, "unknown key `inputs.scaling`"),
        ("output.frame", None, "`output.frame` is missing"),
        ("format", "onnx", '`format` is "onnx"; expected one of flight-aero-network'),
        ("version", 2, "`version` is 2; expected one of 1"),
        ("output.unit", "N", '`output.unit` is "N"'),
        ("output.frame", "wind", '`output.layout` is "link"; expected component, in wind axes'),
        (
            "inputs.features",
            ["joints", "colour"],
            '`inputs.features[1]` is "colour"; expected one of joints, link_position',
        ),
        ("inputs.features", ["joints", "joints"], "each once"),
        ("inputs.features", [], "`inputs.features` is []; expected some of wind, joints"),
        ("inputs.features", 5, "`inputs.features` is 5; expected a list"),
        ("inputs.features", [[1]], "`inputs.features[0]` is [1]; expected one of joints, link_position"),
        ("output.frame", [1], "`output.frame` is [1]; expected one of base, link, wind"),
        ("architecture.activation", "gelu", '`architecture.activation` is "gelu"; expected one of relu, silu, tanh'),
        ("architecture.activation", [1], "`architecture.activation` is [1]; expected one of relu, silu, tanh"),
        ("architecture.members", 0, "`architecture.members` is 0"),
        ("architecture.members", 3, "tensor `member.2.layer.0.weight` is missing"),
        ("architecture.hidden", [5, 5], "tensor `member.0.layer.1.weight` is float32 of shape (4, 5)"),
        ("architecture.hidden", [5, -1], "`architecture.hidden[1]` is -1; expected an integer ≥ 1"),
        ("architecture.hidden", [5], "unknown tensors"),
        ("architecture.mirror", "yes", '`architecture.mirror` is "yes"'),
        ("architecture.baseline.kind", "sphere", '`architecture.baseline.kind` is "sphere"; expected one of axisym'),
        ("architecture.baseline.links", 3, "`architecture.baseline.links` is 3; expected a table"),
        ("architecture.baseline.links", {}, "`architecture.baseline.links` is []; expected ['chest', "),
        ("architecture.baseline.links.head", 3, "`architecture.baseline.links.head` is 3; expected a table"),
        ("architecture.baseline.links.head", {"cda": [1.0], "cna": 0.0}, "links.head.cda` is [1.0]; expected a list"),
        ("architecture.baseline.links.head.cda", ["1"] * 5, 'links.head.cda[0]` is "1"; expected a number'),
        ("weights.sha256", "0" * 64, "`weights.sha256` is '0000"),
        ("weights.file", "../small.safetensors", "beside the card"),
    ],
)
def test_a_wrong_card_is_refused(card, ironcub, key, value, message):
    edit(card, key, value)
    with pytest.raises(ValueError, match=re.escape(message)):
        load_network(card, ironcub)


@pytest.mark.parametrize("key", ["joints", "links"])
def test_another_order_of_joints_or_links_is_refused(card, ironcub, key):
    names = json.loads(card.read_text())["inputs"][key]
    edit(card, f"inputs.{key}", [names[1], names[0], *names[2:]])
    with pytest.raises(ValueError, match=rf"`inputs.{key}` is \['{names[1]}'"):
        load_network(card, ironcub)


def rewrite(card, change):
    path = card.with_suffix(".safetensors")
    tensors = load_file(path)
    change(tensors)
    save_file(tensors, path)
    edit(card, "weights.sha256", hashlib.sha256(path.read_bytes()).hexdigest())


def test_weights_that_are_not_finite_are_refused(card, ironcub):
    rewrite(card, lambda tensors: tensors["member.1.layer.0.bias"].__setitem__(3, np.nan))
    with pytest.raises(ValueError, match=r"tensor `member.1.layer.0.bias` is nan at \(3,\); expected finite"):
        load_network(card, ironcub)


def test_weights_in_another_precision_are_refused(card, ironcub):
    rewrite(card, lambda tensors: tensors.update({"output.scale": np.ones(39)}))
    with pytest.raises(ValueError, match=r"tensor `output\.scale` is float64"):
        load_network(card, ironcub)


def test_a_file_that_is_none_is_refused(card, ironcub):
    path = card.with_suffix(".safetensors")
    path.write_bytes(b"nothing of the kind")
    edit(card, "weights.sha256", hashlib.sha256(path.read_bytes()).hexdigest())
    with pytest.raises(ValueError, match=r"small.safetensors: no safetensors file"):
        load_network(card, ironcub)
    card.write_text("{")
    with pytest.raises(ValueError, match=r"card small.json: no JSON"):
        read_card(card)


def test_infinite_weights_are_not_written(card, ironcub):
    from dataclasses import replace

    network = load_network(card, ironcub)
    with pytest.raises(ValueError, match=r"tensor `output\.offset` is inf"):
        save_network(
            card, replace(network, offset=network.offset.at[3].set(np.inf)), ironcub, description="", training={}
        )


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_network_answers_as_recorded(path, ironcub, made_up_dataset):
    from dataclasses import replace

    card = read_card(path)
    network = load_network(path, ironcub)
    assert network.parameters <= 100_000
    assert card.training["errors"]["grouped"]["mse"] > 0.0
    assert card.training["note"]
    rows = card.training["check"]
    asked = replace(
        made_up_dataset.take(slice(0, len(rows))),
        joint_position_deg=np.array([row["joint_position_deg"] for row in rows]),
        wind_b=np.array([row["wind_b"] for row in rows]),
    )
    with jax.enable_x64(True):
        answer = predict_areas(with_precision(network, np.float64), ironcub, asked)
    np.testing.assert_allclose(answer, [row["areas_b"] for row in rows], rtol=0.0, atol=1e-13)
    # Single precision, as it flies by default.
    np.testing.assert_allclose(predict_areas(network, ironcub, asked), answer, rtol=0.0, atol=1e-7)
