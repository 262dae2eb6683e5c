"""Training: Adam by hand, what dropout does, that a run is reproducible and can stop and go on."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from msgspec import structs

from jax_aero.aero.network import init_network
from jax_aero.base.terminal import ConfigError
from jax_aero.train import (
    Checkpoint,
    Interrupted,
    Settings,
    baseline_errors,
    batch_output,
    distil_samples,
    fit,
    load_checkpoint,
    loop,
    mean_squared_error,
    predict_areas,
    samples_of,
    save_checkpoint,
)
from jax_aero.train.adam import adam_start, adam_step
from jax_aero.train.loop import MATMUL, validation_error
from jax_aero.train.loss import mean_square
from tests.measurements import measured

SETTINGS = Settings(epochs=8, learning_rate=3e-3, batch=32, dropout=0.1, noise={"wind": 0.02}, validate_every=2)


def test_adam_takes_the_steps_of_the_paper():
    """Against the algorithm written out with numbers, three steps, one of them with decay."""
    theta, m, v = np.array([[0.5, -1.0]]), np.zeros((1, 2)), np.zeros((1, 2))
    ours = {"w": jnp.asarray(theta, jnp.float32)}
    state = adam_start(ours)
    for t, (gradient, decay) in enumerate([([0.1, -2.0], 0.0), ([0.3, 0.0], 0.0), ([-0.2, 1.0], 0.1)], start=1):
        g = np.array([gradient])
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g
        theta = theta - 0.01 * (m / (1 - 0.9**t) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8) + decay * theta)
        state, ours = adam_step(state, ours, {"w": jnp.asarray(g, jnp.float32)}, jnp.float32(0.01), weight_decay=decay)
    np.testing.assert_allclose(ours["w"], theta, rtol=2e-5)
    assert int(state.count) == 3


def test_decay_leaves_biases_alone():
    parameters = {"weight": jnp.ones((1, 2, 2)), "bias": jnp.ones((1, 2))}
    zero = jax.tree.map(jnp.zeros_like, parameters)
    _, moved = adam_step(adam_start(parameters), parameters, zero, jnp.float32(0.1), weight_decay=0.5)
    np.testing.assert_allclose(moved["weight"], 0.95)
    np.testing.assert_allclose(moved["bias"], 1.0)


@pytest.mark.close_to_tolerance("the spread of a mean over random masks, drawn with one seed")
def test_dropout_spares_the_first_layer_and_keeps_the_mean(ironcub):
    network = init_network(jax.random.key(0), ironcub, hidden=(6, 400), activation="relu")
    x = jnp.ones((2000, 22))  # every row is another draw
    key = jax.random.key(1)
    calm = batch_output(network.layers, "relu", x)[0]
    noisy = batch_output(network.layers, "relu", x, key, 0.1)[0]
    assert jnp.abs(noisy[0] - noisy[1]).max() > 1e-3
    np.testing.assert_allclose(noisy.mean(0), calm[0], atol=4 * float(noisy.std(0).max()) / np.sqrt(2000))
    shallow = network.layers[:1] + network.layers[-1:]
    shallow = (shallow[0], replace(shallow[1], weight=shallow[1].weight[:, :, :6]))
    same = batch_output(shallow, "relu", x, key, 0.5)
    np.testing.assert_array_equal(same, batch_output(shallow, "relu", x))


def test_without_dropout_nothing_is_drawn(ironcub, agree):
    network = init_network(jax.random.key(0), ironcub, hidden=(6, 6))
    x = jnp.ones((2, 22))
    plain = batch_output(network.layers, "relu", x)
    np.testing.assert_array_equal(batch_output(network.layers, "relu", x, jax.random.key(1), 0.0), plain)
    agree("mean squared error", float(mean_squared_error(plain, plain[0] + 0.5)), 39 * 0.25, 1e-6)
    errors = np.ones((4, 13, 3)) * np.arange(4.0)[:, None, None]
    agree("errors of rows", mean_square(errors), 39 * (0 + 1 + 4 + 9) / 4, 1e-12)


@pytest.fixture(scope="module")
def task(ironcub, made_up_dataset):
    network = init_network(jax.random.key(0), ironcub, hidden=(16, 16), activation="tanh", mirror=True, start="unit")
    rows = made_up_dataset.add_mirror_images()
    train, held_out = rows.grouped_folds(0)[0]
    return network, samples_of(network, ironcub, rows.take(train)), samples_of(network, ironcub, rows.take(held_out))


def weights(network):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(network.layers)]


def same_bits(one, other):
    return all(np.array_equal(a, b) for a, b in zip(weights(one), weights(other), strict=True))


def test_training_learns_and_is_deterministic(task):
    network, training, validation = task
    settings = structs.replace(SETTINGS, epochs=40, dropout=0.0)
    first = fit(network, training, validation, settings, seed=1)
    second = fit(network, training, validation, settings, seed=1)
    other = fit(network, training, validation, settings, seed=2)
    spread = training.y.shape[1] * float(np.var(training.y))
    assert first.curves[0][1] > first.curves[-1][1]
    assert first.curves[-1][1] < 0.1 * spread
    assert first.curves[-1][2] < 0.3 * spread
    assert first.curves == second.curves
    assert same_bits(first.network, second.network)
    assert not same_bits(first.network, other.network)


@pytest.mark.close_to_tolerance("rounding of single precision")
@pytest.mark.parametrize("count", [0, 1, 3, 5, 7])
def test_the_rate_rises_and_then_falls_along_half_a_cosine(count, agree):
    """Two epochs of four steps; the rate has risen after two of them."""
    settings = Settings(epochs=2, learning_rate=0.1, schedule="cosine", warm_up=2)
    share = 0.5 * (1.0 + np.cos(np.pi * count / 8))
    # In single precision, the sum with a cosine near -1 keeps its absolute rounding.
    tolerance = 4.0 * float(np.finfo(np.float32).eps) / share
    expected = 0.1 * share * min(1.0, (count + 1) / 2)
    agree("rate", float(loop._rate(settings, jnp.asarray(count), 4)), expected, tolerance)


def test_one_epoch_of_one_batch_trains(task):
    """Its only step has the whole rate."""
    network, training, _ = task
    settings = structs.replace(SETTINGS, epochs=1, batch=0, schedule="cosine", warm_up=0)
    trained = fit(network, training, None, settings, seed=1).network
    assert np.abs(trained.layers[0].weight - network.layers[0].weight).max() > 0.5 * settings.learning_rate


def test_a_run_that_was_stopped_ends_with_the_same_bits(task, tmp_path):
    network, training, validation = task
    path = tmp_path / "run.checkpoint"
    whole = fit(network, training, validation, SETTINGS, seed=5)

    def stop(epoch, _train, _error):
        if epoch in (3, 6):
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(Interrupted):
            fit(network, training, validation, SETTINGS, seed=5, checkpoint=path, on_epoch=stop)
    epochs = []
    rest = fit(
        network, training, validation, SETTINGS, 5, checkpoint=path, on_epoch=lambda epoch, *_: epochs.append(epoch)
    )
    assert epochs == [7, 8]
    assert rest.curves == whole.curves
    assert same_bits(rest.network, whole.network)


def test_the_checkpoint_of_another_run_does_not_count(task, tmp_path):
    network, training, validation = task
    path, epochs = tmp_path / "run.checkpoint", []
    settings = structs.replace(SETTINGS, epochs=1)
    for seed in (5, 6, 6):
        fit(network, training, validation, settings, seed, checkpoint=path, on_epoch=lambda *row: epochs.append(row[0]))
    assert epochs == [1, 1], "the third goes on with the checkpoint of the second"


def test_a_damaged_checkpoint_does_not_count(tmp_path):
    """Empty, foreign, cut short, and with any one byte inverted, also where the content would be read as it was."""
    path, state = tmp_path / "run.checkpoint", {"a": jnp.zeros(2)}
    save_checkpoint(path, "d", Checkpoint(state, {}))
    whole = path.read_bytes()
    changed = [whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :] for at in range(len(whole))]
    for damaged in (b"nothing", b"", whole[: len(whole) // 2], *changed):
        path.write_bytes(damaged)
        assert load_checkpoint(path, "d", state) is None


def test_a_checkpoint_keeps_every_bit(tmp_path):
    state = {"a": jnp.asarray([1.0, np.nextafter(np.float32(1.0), 2)], jnp.float32), "n": jnp.asarray(3, jnp.int32)}
    save_checkpoint(tmp_path / "c.checkpoint", "d", Checkpoint(state, {"best": None}))
    found = load_checkpoint(tmp_path / "c.checkpoint", "d", state)
    assert found.facts == {"best": None}
    assert found.state["a"].tobytes() == state["a"].tobytes()
    assert found.state["n"].dtype == np.int32
    assert load_checkpoint(tmp_path / "none.checkpoint", "d", state) is None


def test_the_error_is_that_of_the_last_validation(task):
    network, training, validation = task
    last = fit(network, training, validation, structs.replace(SETTINGS, epochs=3), seed=0)
    assert last.error == last.curves[-1][2]
    assert fit(network, training, None, SETTINGS, seed=0).error is None


def test_validation_is_that_of_the_network_as_it_flies(task, ironcub, made_up_dataset, agree):
    """No dropout, symmetrised, in square metres of base axes."""
    network, training, _ = task
    trained = fit(network, training, None, structs.replace(SETTINGS, dropout=0.5), seed=0).network
    rows = made_up_dataset.take(slice(0, 40))
    expected = np.mean(np.sum((predict_areas(trained, ironcub, rows) - rows.force_area_b) ** 2, axis=(1, 2)))
    agree("validation error", validation_error(trained, samples_of(trained, ironcub, rows)), expected, 1e-4)


def test_lower_precision_trains_too(task, monkeypatch):
    """The setting governs the training steps alone: validation is as precise as the flight."""
    network, training, _ = task
    used = []

    def validate(network, x, y, count):
        used.append(jax.config.jax_default_matmul_precision)
        return 1.0

    monkeypatch.setattr(loop, "_sum_of_squares", validate)
    found = fit(network, training, training, structs.replace(SETTINGS, epochs=2, matmul="bf16"), seed=0)
    assert np.isfinite(found.curves[-1][1])
    assert used
    assert set(used) == {"highest"}
    for name in MATMUL.values():
        with jax.default_matmul_precision(name):
            pass


def test_a_diverging_run_says_so(task):
    network, training, _ = task
    with pytest.raises(FloatingPointError, match="training loss is"):
        fit(replace(network, activation="relu"), training, None, structs.replace(SETTINGS, learning_rate=1e9), seed=0)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("epochs", 0, "an integer ≥ 1"),
        ("learning_rate", -1e-3, "a number > 0"),
        ("batch", -1, "an integer ≥ 0"),
        ("weight_decay", float("nan"), "a finite number"),
        ("beta2", 1.0, "a number > 0 and < 1"),
        ("schedule", "linear", "one of constant, cosine"),
        ("matmul", "f8", "one of"),
    ],
)
def test_settings_that_are_made_in_python_are_checked_too(task, key, value, expected):
    network, training, _ = task
    with pytest.raises(ConfigError, match=re.escape(f"settings: `{key}` is ") + f".*; expected {expected}"):
        fit(network, training, None, structs.replace(SETTINGS, **{key: value}), seed=0)


def test_rows_that_do_not_fill_the_only_batch_are_left_to_other_epochs(task):
    network, training, _ = task
    settings = structs.replace(SETTINGS, epochs=3, batch=len(training.x) - 8, scale_output=False)
    other = training._replace(y=np.concatenate([training.y[:-8], training.y[-8:] + 1.0]))
    one, another = (fit(network, samples, None, settings, seed=0).network for samples in (training, other))
    assert not same_bits(one, another)


def test_a_student_learns_from_the_mean_of_its_teachers(ironcub, made_up_dataset):
    teachers = [init_network(jax.random.key(k), ironcub, hidden=(4,)) for k in range(2)]
    samples = distil_samples(teachers, ironcub, made_up_dataset, count=30, spread_deg=3.0, seed=0)
    assert len(samples.x) == len(made_up_dataset) + 30
    both = [predict_areas(teacher, ironcub, made_up_dataset) for teacher in teachers]
    order = np.mean(both, axis=0)[:, :, [0, 2, 1]].transpose(0, 2, 1).reshape(len(made_up_dataset), 39)
    np.testing.assert_allclose(samples.y[: len(made_up_dataset)], order, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(samples.x[:, :3], axis=1), 1.0, rtol=1e-5)


def test_the_baselines_are_what_they_say(ironcub, made_up_dataset):
    train, held_out = made_up_dataset.grouped_folds(1, 3)[0]
    found = baseline_errors(ironcub, made_up_dataset.take(train), made_up_dataset.take(held_out))
    assert set(found) == {
        *("axisymmetric, published", "axisymmetric, corrected", "axisymmetric, signed"),
        *("nearest", "linear"),
    }
    # The made-up areas are linear in the wind, up to a factor by posture.
    assert found["linear"] < 0.2 * 39 * np.var(made_up_dataset.force_area_b)
    # Rows that were trained on are their own neighbours.
    known = made_up_dataset.take(train)
    measured("nearest neighbour of known samples", baseline_errors(ironcub, known, known)["nearest"], 1e-12)
