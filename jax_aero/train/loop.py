"""The training loop: epochs of minibatches, validation without dropout, checkpoints.

What the outputs of a network are compared with is an `Objective`: the force areas of rows (`ForceAreas`), or wrenches
that were observed in flights (`jax_aero.train.wrench.ObservedWrenches`).
"""

from __future__ import annotations

import functools
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Protocol, TypeAlias

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float

from jax_aero.aero.network import Layer, Network, raw_output
from jax_aero.base import plain_values, tables
from jax_aero.base.network_inputs import BLOCKS, block_sizes
from jax_aero.base.terminal import ConfigError
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jax_aero.train.loss import batch_output, mean_squared_error
from jax_aero.train.samples import Samples, chunks
from jax_aero.types import Array, pytree

MATMUL = {"float32": "float32", "tf32": "tensorfloat32", "bf16": "bfloat16"}
"""Precision of the matrix products of a training step, by its name in a configuration; a CPU may be more exact."""


class Settings(tables.Table, frozen=True):
    """Settings of the training of a network; one table of a file in `configs/training/`."""

    epochs: tables.Count
    learning_rate: tables.Positive
    batch: tables.Natural = 0
    """Rows per step; 0 for all rows. Rows that do not fill a batch are left to other epochs, with other orders."""
    schedule: Literal["constant", "cosine"] = "constant"
    """Whether the learning rate is constant, or falls along half a cosine that reaches zero after the last step."""
    warm_up: tables.Natural = 0
    """Steps over which the learning rate rises from zero."""
    beta2: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.999
    weight_decay: tables.NonNegative = 0.0
    dropout: Annotated[float, msgspec.Meta(ge=0.0, lt=1.0)] = 0.0
    noise: dict[str, tables.NonNegative] = msgspec.field(default_factory=dict)
    """Standard deviation of noise on the features, by block, so that similar postures have similar outputs."""
    matmul: Literal["float32", "tf32", "bf16"] = "float32"
    """Precision of matrix products; a processor without the lower ones uses float32."""
    scale_output: bool = True
    """Whether outputs are scaled by the spread of the targets, about their mean."""
    validate_every: tables.Count = 1
    """Epochs between validations."""

    def __post_init__(self) -> None:
        if unknown := set(self.noise) - set(BLOCKS):
            raise ConfigError.of("noise", sorted(unknown), f"blocks of features, {', '.join(BLOCKS)}")

    def __hash__(self) -> int:
        # Settings are a static, therefore hashed, argument of compiled functions.
        return hash(msgspec.json.encode(self))


ERROR_UNIT = "m^4, sum over components, mean over rows"
"""Unit of losses and errors, of cards too."""

Curve: TypeAlias = tuple[int, float, float | None]
"""Completed epochs, training loss (with dropout and noise, mean over the epoch), validation loss [m⁴] if any."""


class FitResult(NamedTuple):
    """Result of a training."""

    network: Network
    error: float | None
    """Validation loss of the network [m⁴ or the objective's unit]; `None` without validation."""
    curves: tuple[Curve, ...]
    """Loss curves, one entry per validation."""
    epochs: int
    """Number of completed epochs."""
    seconds_per_epoch: float
    """Seconds per epoch of this call, without the first epoch, which compiles, if there are more."""


class Objective(Protocol):
    """What a training compares the outputs of a network with; hashable, since it is part of what is compiled."""

    def scaled(self, network: Network, training: Any) -> Network:
        """Return the network with the scale and offset of its outputs, where the settings want them."""

    def given(self, network: Network, training: Any) -> tuple[Any, Any]:
        """Return what outputs are compared with, by row, and what is the same for all rows; pytrees of arrays."""

    def loss(self, output: Float[Array, "m B *copies y"], rows: Any, common: Any) -> Float[Array, ""]:
        """Return the loss of a batch from outputs before scaling, as by `batch_output`."""

    def unit(self, network: Network) -> float:
        """Return the unit of `loss` in that of curves."""

    def error(self, network: Network, validation: Any) -> float:
        """Return the validation loss of a network as it flies."""


@dataclass(frozen=True)
class ForceAreas:
    """Force areas of the links, row by row: the paper's mean squared error [m⁴]."""

    def scaled(self, network: Network, training: Samples) -> Network:
        """Scale by the spread of all targets, about the mean of each."""
        offset = training.y.mean(axis=0)
        scale = np.full_like(offset, training.y.std())
        return replace(network, scale=jnp.asarray(scale), offset=jnp.asarray(offset))

    def given(self, network: Network, training: Samples) -> tuple[Any, Any]:
        """Return the targets before scaling."""
        return jnp.asarray((training.y - network.offset) / network.scale), ()

    def loss(self, output: Float[Array, "m B y"], rows: Float[Array, "B y"], common: Any) -> Float[Array, ""]:
        """Return the mean squared error."""
        del common
        return mean_squared_error(output, rows)

    def unit(self, network: Network) -> float:
        """Return the square of the scale [m⁴]."""
        return float(network.scale[0]) ** 2

    def error(self, network: Network, validation: Samples) -> float:
        """Return the mean squared error [m⁴]."""
        return validation_error(network, validation)


FORCE_AREAS = ForceAreas()


class Interrupted(KeyboardInterrupt):
    """Training was interrupted by the user; the checkpoint holds the last complete epoch."""


@pytree
class _State:
    layers: tuple[Layer, ...]
    adam: AdamState


class _Now(NamedTuple):
    """State of a run after a complete epoch."""

    state: _State
    epoch: int
    curves: tuple[Curve, ...]


def fit(
    network: Network,
    training: Any,
    validation: Any,
    settings: Settings,
    seed: int,
    *,
    objective: Objective = FORCE_AREAS,
    checkpoint: Path | None = None,
    checkpoint_seconds: float = 30.0,
    on_epoch: Callable[[int, float, float | None], None] | None = None,
) -> FitResult:
    """Train a network, resuming from its checkpoint if there is one.

    Parameters
    ----------
    network
        Network with the initial weights; scale and offset are set from the training samples if the settings say so.
    training, validation
        Samples of the objective, with mirror images if wanted: tuples of arrays whose first axis is that of rows, `x`
        the features. The latter may be `None`.
    seed
        Seed of the order of rows, dropout and noise.
    on_epoch
        Called with epochs done, training and validation loss.

    Raises
    ------
    ValueError
        If a setting is invalid, naming its key; or if a batch is larger than the data.
    Interrupted
        On Ctrl-C, after the checkpoint is written.
    """
    settings = tables.convert(plain_values.to_table(settings), Settings, "settings")
    count = len(training.x)
    batch = settings.batch or count
    if batch > count:
        raise ValueError(f"`batch` is {batch}; there are {count} rows")
    if settings.scale_output:
        network = objective.scaled(network, training)
    digest = _digest(network, training, validation, settings, seed, objective)
    now = _Now(_State(network.layers, adam_start(network.layers)), 0, ())
    if checkpoint is not None and (stored := load_checkpoint(checkpoint, digest, now.state)):
        curves = tuple((row[0], row[1], row[2]) for row in stored.facts["curves"])
        now = _Now(stored.state, stored.facts["epoch"], curves)
    data = (jnp.asarray(training.x), *objective.given(network, training))
    noise = _noise(network, settings)
    run = functools.partial(_epoch, settings, objective, network.activation, batch)
    unit = objective.unit(network)
    times: list[float] = []
    saved = time.perf_counter()
    with jax.default_matmul_precision(MATMUL[settings.matmul]):
        try:
            while now.epoch < settings.epochs:
                started = time.perf_counter()
                state, loss = run(now.state, data, noise, jnp.uint32(seed), jnp.uint32(now.epoch))
                train_error, error = float(loss) * unit, None
                if not np.isfinite(train_error):
                    raise FloatingPointError(f"training loss is {train_error} in epoch {now.epoch + 1}: rate too large")
                is_due = (now.epoch + 1) % settings.validate_every == 0 or now.epoch + 1 == settings.epochs
                if validation is not None and is_due:
                    error = objective.error(replace(network, layers=state.layers), validation)
                # One assignment, so that an interruption leaves the last complete epoch.
                seen = ((now.epoch + 1, train_error, error),) if is_due else ()
                now = _Now(state, now.epoch + 1, (*now.curves, *seen))
                times.append(time.perf_counter() - started)
                if on_epoch is not None:
                    on_epoch(now.epoch, train_error, error)
                if checkpoint is not None and time.perf_counter() - saved > checkpoint_seconds:
                    _keep(checkpoint, digest, now)
                    saved = time.perf_counter()
        except KeyboardInterrupt:
            if checkpoint is not None:
                _keep(checkpoint, digest, now)
            raise Interrupted from None
    if checkpoint is not None:
        _keep(checkpoint, digest, now)
    trained, steady = replace(network, layers=now.state.layers), times[1:] or times or [0.0]
    return FitResult(trained, now.curves[-1][2], now.curves, now.epoch, float(np.mean(steady)))


def _keep(path: Path, digest: str, now: _Now) -> None:
    save_checkpoint(path, digest, Checkpoint(now.state, {"epoch": now.epoch, "curves": list(now.curves)}))


def validation_error(network: Network, samples: Samples) -> float:
    """Return the mean squared error [m⁴] of the network, summed over components.

    As in flight: without dropout and noise, symmetrised if it is.

    Matrix products have the precision of flight, whatever precision training uses.
    """
    with jax.default_matmul_precision("highest"):
        total = sum(float(_sum_of_squares(network, x, y, count)) for count, (x, y) in chunks(samples.x, samples.y))
    return total / len(samples.y)


@jax.jit
def _sum_of_squares(network: Network, x: Array, y: Array, count: int) -> Array:
    """Return the sum of squared errors over the first `count` rows."""
    squares = jnp.sum((jax.vmap(functools.partial(raw_output, network))(x) - y) ** 2, axis=1)
    return jnp.sum(jnp.where(jnp.arange(len(squares)) < count, squares, 0.0))


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _epoch(
    settings: Settings,
    objective: Objective,
    activation: str,
    batch: int,
    state: _State,
    data: tuple[Array, Any, Any],
    noise: Array,
    seed: Array,
    epoch: Array,
) -> tuple[_State, Array]:
    """Train on all data once; random numbers depend only on seed and epoch."""
    x, given, common = data
    steps = x.shape[0] // batch
    key = jax.random.fold_in(jax.random.key(seed), epoch)
    order_key, noise_key = jax.random.split(key)
    order = jax.random.permutation(order_key, x.shape[0]) if batch < x.shape[0] else jnp.arange(x.shape[0])

    def loss(layers: tuple[Layer, ...], rows: Array, key: Array) -> Array:
        for_noise, for_dropout = jax.random.split(key)
        seen = x[rows]
        if settings.noise:
            seen = seen + noise * jax.random.normal(for_noise, seen.shape, seen.dtype)
        flat = seen.reshape(-1, seen.shape[-1])
        output = batch_output(layers, activation, flat, for_dropout, settings.dropout)
        output = output.reshape(output.shape[0], *seen.shape[:-1], output.shape[-1])
        return objective.loss(output, jax.tree.map(lambda leaf: leaf[rows], given), common)

    def step(state: _State, entry: Any) -> tuple[_State, Array]:
        index, rows = entry
        value, gradient = jax.value_and_grad(loss)(state.layers, rows, jax.random.fold_in(noise_key, index))
        rate = _rate(settings, state.adam.count, steps)
        options = {"beta2": settings.beta2, "weight_decay": settings.weight_decay}
        adam, layers = adam_step(state.adam, state.layers, gradient, rate, **options)
        return _State(layers, adam), value

    rows = order[: steps * batch].reshape(steps, batch)
    state, losses = jax.lax.scan(step, state, (jnp.arange(steps), rows))
    return state, losses.mean()


def _rate(settings: Settings, count: Array, steps_per_epoch: int) -> Array:
    """Return the learning rate of a step, after `count` others."""
    done = count.astype(jnp.float32)
    rate = jnp.float32(settings.learning_rate)
    if settings.schedule == "cosine":
        total = jnp.float32(steps_per_epoch * settings.epochs)
        rate = rate * 0.5 * (1.0 + jnp.cos(jnp.float32(np.pi) * done / total))
    risen: Array = rate * jnp.minimum(1.0, (done + 1.0) / max(settings.warm_up, 1))
    return risen


def _noise(network: Network, settings: Settings) -> Array:
    sizes = block_sizes(len(network.joints), network.scale.shape[0] // 3)
    parts = [np.full(sizes[block], settings.noise.get(block, 0.0), np.float32) for block in network.blocks]
    return jnp.asarray(np.concatenate(parts))


def _digest(
    network: Network, training: Any, validation: Any, settings: Settings, seed: int, objective: Objective
) -> str:
    total = hashlib.sha256(json.dumps([plain_values.to_builtins(settings), ERROR_UNIT, seed], sort_keys=True).encode())
    shape = (network.blocks, network.frame, network.layout, network.activation, network.mirror is None, objective)
    total.update(repr(shape).encode())
    for array in jax.tree.leaves((training, validation, network.layers)):
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()
