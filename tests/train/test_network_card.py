"""Weights and their card: what is read back, what is refused, and that the shipped ones answer as recorded."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from jax_aero.aero.network import init_network, with_precision
from jax_aero.aero.network_card import load_network, save_network
from jax_aero.base.terminal import ConfigError
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


def test_a_card_that_cannot_be_written_leaves_the_old_weights(card, ironcub):
    """JSON has no NaN; a card that had one could not be read by others."""
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
        patched.setattr("jax_aero.base.cards.write_text", interrupt)
        with pytest.raises(KeyboardInterrupt):
            save_network(card, network, ironcub, description="made up", training={})
    with pytest.raises(ValueError, match=r"`weights\.sha256` is "):
        load_network(card, ironcub)
    assert kept.read_bytes() == before  # who had them open still has all of them


def test_what_is_written_is_read_back(card, ironcub):
    network = load_network(card, ironcub)
    again = card.with_name("again.json")
    save_network(again, network, ironcub, description="made up", training={"note": "not trained"})
    assert again.with_suffix(".safetensors").read_bytes() == card.with_suffix(".safetensors").read_bytes()
    ours, theirs = (json.loads(path.read_text()) for path in (card, again))
    assert (ours["name"], theirs["name"]) == ("small", "again")
    assert ours["weights"]["sha256"] == theirs["weights"]["sha256"]
    assert theirs | {key: ours[key] for key in ("name", "weights")} == ours
    assert network.parameters == 2 * (58 * 5 + 5 + 5 * 4 + 4 + 4 * 39 + 39)


def test_the_crate_refuses_a_wrong_card(card, ironcub):
    """What it refuses: `rust/core/tests/network.rs`, `rust/io/tests/files.rs`."""
    document = json.loads(card.read_text())
    document["architecture"]["members"] = 0
    card.write_text(json.dumps(document))
    with pytest.raises(ConfigError, match=r"small\.json: `architecture\.members` is 0") as refused:
        load_network(card, ironcub)
    assert (refused.value.file, refused.value.key) == (str(card), "architecture.members")


def test_infinite_weights_are_not_written(card, ironcub):
    network = load_network(card, ironcub)
    with pytest.raises(ValueError, match=r"tensor `output\.offset` is inf"):
        save_network(
            card, replace(network, offset=network.offset.at[3].set(np.inf)), ironcub, description="", training={}
        )


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_network_answers_as_recorded(path, ironcub, made_up_dataset):
    training = json.loads(path.read_text())["training"]
    network = load_network(path, ironcub)
    assert network.parameters <= 100_000
    assert training["errors"]["grouped"]["mse"] > 0.0
    assert training["note"]
    rows = training["check"]
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
