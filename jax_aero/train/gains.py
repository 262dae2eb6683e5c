"""Tuning of a flight controller's gains and weights by gradients through short flights in many worlds.

```text
θ     logarithms of the factors on the tuned values
c     1/n Σ ( |e|²/e₀² + φ²/φ₀² + mean(Ṫ²)/Ṫ₀² )     of a flight of n ticks; `lost` for every tick after a loss
J     mean of log c over the worlds of a batch
```

The logarithm gives every world the same weight, whatever its difficulty. The gradient of a flight that is about to be
lost is larger by orders of magnitude and dominates the others, so worlds whose gradient is longer than `gradient_max`,
or not finite, are left out of a step, and counted. Since nothing else then keeps the values away from where flights are
lost, validation does: if its cost is not less than the least so far, the values return to the best ones and the rate is
halved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, reduce
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero.base import tables
from jax_aero.base.places import did_you_mean
from jax_aero.base.terminal import ConfigError
from jax_aero.sim.batch import Group
from jax_aero.sim.plant import COMPILER_OPTIONS
from jax_aero.sim.rollout import rollout
from jax_aero.sim.scenario import Scenario
from jax_aero.sim.signals import FlightRow
from jax_aero.sim.step import FlightState
from jax_aero.train.adam import AdamState, adam_start, adam_step
from jax_aero.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jax_aero.types import Array, pytree, replace_values

PLACES = {
    "momentum": "momentum",
    "disturbance_observer": "observer",
    "posture_gain": "tasks.posture_gain",
    "torque": "torque",
    "weights": "tasks",
}
"""Place of the numbers of each table of the controller's configuration in `MomentumController`."""


class Cost(tables.Table, frozen=True):
    """Errors and efforts of unit cost."""

    position: tables.Positive
    """Error of the centre of mass, e₀ [m]."""
    rotation_deg: tables.Positive
    """Rotation error, φ₀ [deg]."""
    thrust_rate: tables.Positive
    """Root mean square thrust rate over the jets, Ṫ₀ [N/s]."""
    lost: tables.Positive
    """Cost of each tick after the loss of a flight."""


class Steps(tables.Table, frozen=True):
    """Settings of the optimisation."""

    count: tables.Count
    """Number of Adam steps."""
    batch: tables.Count
    """Worlds per step; none is used twice."""
    learning_rate: tables.Positive
    """Initial learning rate of the logarithms."""
    gradient_max: tables.Positive
    """Length of a world's gradient beyond which it is left out of a step."""
    validation: tables.Count
    """Number of worlds that select the answer and are not trained on: a multiple of `batch`."""
    validate_every: tables.Count
    """Steps between validations."""

    def __post_init__(self) -> None:
        if self.validation % self.batch:
            raise ConfigError.of("validation", self.validation, f"a multiple of `batch`, {self.batch}")


Sample: TypeAlias = Callable[[Array, int], tuple[Array, Array]]
"""Costs (B,) and their gradients (B, k) for the worlds of a step, numbered from 0, or for a part of the validation's
worlds, numbered from −1 downwards."""


class Validation(NamedTuple):
    """Result of a validation."""

    step: int
    cost: float
    """Mean of log c over the validation's worlds."""
    logarithms: tuple[float, ...]
    """θ at that step."""


class TuningResult(NamedTuple):
    """Result of a run."""

    logarithms: Float[Array, " k"]
    """θ with the least validation cost."""
    costs: tuple[float, ...]
    """Mean of log c over the worlds of every step."""
    left_out: tuple[int, ...]
    """Number of worlds left out of every step."""
    validations: tuple[Validation, ...]


@pytree
class _State:
    logarithms: Float[Array, " k"]
    adam: AdamState
    best: Float[Array, " k"]
    rate: Float[Array, ""]


def tune(sample: Sample, size: int, steps: Steps, *, checkpoint: Path, digest: str) -> TuningResult:
    """Optimise `size` logarithms from zero, or resume from the checkpoint of this digest."""
    theta = jnp.zeros(size)
    state, step = _State(theta, adam_start(theta), theta, jnp.asarray(steps.learning_rate)), 0
    costs: list[float] = []
    left_out: list[int] = []
    seen: list[Validation] = []

    def validate(state: _State) -> _State:
        parts = [sample(state.logarithms, -1 - part)[0] for part in range(steps.validation // steps.batch)]
        cost, tried = float(np.mean(parts)), tuple(np.asarray(state.logarithms).tolist())
        if all(cost < before.cost for before in seen):
            state = replace(state, best=state.logarithms)
        else:
            state = _State(state.best, adam_start(state.best), state.best, 0.5 * state.rate)
        seen.append(Validation(step, cost, tried))
        facts = {"step": step, "costs": costs, "left_out": left_out, "validations": seen}
        save_checkpoint(checkpoint, digest, Checkpoint(state, facts))
        return state

    if found := load_checkpoint(checkpoint, digest, state):
        state, step = found.state, found.facts["step"]
        costs, left_out = found.facts["costs"], found.facts["left_out"]
        seen = [Validation(at, cost, tuple(values)) for at, cost, values in found.facts["validations"]]
    else:
        state = validate(state)
    while step < steps.count:
        values, gradients = sample(state.logarithms, step)
        is_sound = jnp.linalg.norm(gradients, axis=1) <= steps.gradient_max  # false for NaN
        mean = jnp.sum(jnp.where(is_sound[:, None], gradients, 0.0), axis=0) / jnp.maximum(jnp.sum(is_sound), 1)
        adam, theta = adam_step(state.adam, state.logarithms, mean, state.rate)
        state, step = replace(state, logarithms=theta, adam=adam), step + 1
        costs.append(float(jnp.mean(values)))
        left_out.append(int(jnp.sum(~is_sound)))
        if step % steps.validate_every == 0 or step == steps.count:
            state = validate(state)
    return TuningResult(state.best, tuple(costs), tuple(left_out), tuple(seen))


def gradients(
    theta: Float[Array, " k"], group: Group, keys: tuple[str, ...], cost: Cost
) -> tuple[Float[Array, " B"], Float[Array, "B k"]]:
    """Return log c of each flight of a group, and its gradients; flights of one structure share one compilation."""
    compiled = _compile_gradient(group.structure, group.axes, keys, cost, group.n_ticks)
    return compiled(theta, *group.stack(range(len(group.places))))


@lru_cache(maxsize=8)
def _compile_gradient(
    structure: Any, axes: tuple[int | None, ...], keys: tuple[str, ...], cost: Cost, n_ticks: int
) -> Callable[..., tuple[Array, Array]]:
    def cost_of(theta: Array, leaves: tuple[Array, ...], state: FlightState) -> Array:
        return log_cost(scale_values(jax.tree.unflatten(structure, leaves), keys, theta), state, cost, n_ticks)

    gradients = jax.vmap(jax.value_and_grad(cost_of), in_axes=(None, axes, 0))
    compiled: Callable[..., Any] = jax.jit(gradients, compiler_options=COMPILER_OPTIONS)
    return compiled


def log_cost(scenario: Scenario, state: FlightState, cost: Cost, n_ticks: int) -> Float[Array, ""]:
    """Return log c of one flight."""

    def errors(row: FlightRow) -> tuple[Array, Array, Array]:
        return row["com_position"] - row["com_setpoint"], row["rotation_error"], row["thrust_rate"]

    after, (position, rotation, rate) = rollout(scenario, state, n_ticks, errors)
    squares = (
        jnp.sum(position**2, axis=1) / cost.position**2
        + rotation**2 / np.deg2rad(cost.rotation_deg) ** 2
        + jnp.mean(rate**2, axis=1) / cost.thrust_rate**2
    )
    flies = (after.loss_tick < 0) | (jnp.arange(n_ticks) < after.loss_tick)
    return jnp.log(jnp.mean(jnp.where(flies, squares, cost.lost)))


def scale_values(scenario: Scenario, keys: Sequence[str], logarithms: Float[Array, " k"]) -> Scenario:
    """Return the scenario with the controller's values at these keys multiplied by the exponentials of θ.

    Raises
    ------
    ValueError
        If the controller has no number for a key; the message names it.
    """
    values = {}
    for key, logarithm in zip(keys, logarithms, strict=True):
        place = _place(key)
        before: Any = reduce(lambda part, name: getattr(part, name, None), place.split("."), cast(Any, scenario))
        if not isinstance(before, jax.Array):
            raise ValueError(f"`{key}` cannot be tuned; expected what the controller has as one number or array")
        values[place] = before * jnp.exp(logarithm)
    return replace_values(scenario, values)


def _place(key: str) -> str:
    """Return the dotted name in a scenario of the value at a key of the controller's configuration."""
    first, _, rest = key.partition(".")
    if first not in PLACES:
        raise ValueError(f"`{key}` cannot be tuned{did_you_mean(first, PLACES)}")
    return ".".join(part for part in ("controller", PLACES[first], rest) if part)
