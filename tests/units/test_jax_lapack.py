"""Batches reach LAPACK a few samples at a time: jaxlib's kernels for larger ones can wait for each other for ever.

The programs are made for a CPU but not compiled, so nothing can hang here; see `CONTRIBUTING.md`.
"""

from __future__ import annotations

import dataclasses
import re
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jax_aero import rust, sim
from jax_aero.aero.network_card import load_network
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.batches import CHUNK, any_in_batch
from jax_aero.body.linalg import invert, solve_positive_definite
from jax_aero.body.robot import load_robot
from jax_aero.control import qp

pytestmark = pytest.mark.usefixtures("x64")

BATCH = 64
"""Large enough for jaxlib to split: it does at 33."""


def lapack_batches(function, *arguments):
    """Samples per call of every call of LAPACK in the program of a function of a batch; 1 without a batch axis."""
    lowered = jax.jit(function).trace(*arguments).lower(lowering_platforms=("cpu",)).as_text()
    calls = re.findall(r"custom_call @lapack\w+\(.*?: \(tensor<([0-9x]+)xf(?:32|64)>", lowered)
    # Operations of StableHLO itself would not show under the kernels' names.
    calls += re.findall(r"stablehlo\.(?:cholesky|triangular_solve).*?tensor<([0-9x]+)xf(?:32|64)>", lowered)
    return [int(np.prod([int(size) for size in shape.split("x")][:-2])) for shape in calls]


@pytest.mark.parametrize("function", [jnp.linalg.cholesky, jnp.linalg.inv, jnp.linalg.eigh, jnp.linalg.svd])
def test_raw_linear_algebra_is_what_is_looked_for(function):
    """Without this, a test that finds nothing would pass."""
    found = lapack_batches(jax.vmap(function), jnp.zeros((BATCH, 5, 5)))
    assert found
    assert max(found) == BATCH


def test_ours_goes_in_pieces():
    assert set(
        lapack_batches(jax.vmap(solve_positive_definite), jnp.zeros((BATCH, 5, 5)), jnp.zeros((BATCH, 5, 2)))
    ) == {CHUNK}


def test_a_choice_by_any_of_a_batch_computes_one_branch():
    """Also under nested batches, with the values and derivatives of each sample; by each sample both are computed."""

    def double(x, decides):
        return lax.cond(decides(x > 2.0), lambda: jnp.where(x > 2.0, 2.0 * x, x), lambda: x)

    batch, rows = jnp.arange(4.0), jnp.arange(6.0).reshape(2, 3)
    for decides, is_kept in ((any_in_batch, True), (lambda x: x, False)):
        found = jax.vmap(jax.value_and_grad(partial(double, decides=decides)))
        assert ("cond" in str(jax.make_jaxpr(found)(batch))) == is_kept
        assert [part.tolist() for part in found(batch)] == [[0.0, 1.0, 2.0, 6.0], [1.0, 1.0, 1.0, 2.0]]
        assert jax.vmap(found)(rows)[1].tolist() == [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]
    found = jax.make_jaxpr(jax.vmap(jax.vmap(partial(double, decides=any_in_batch))))(rows)
    assert "cond" in str(found)


EVERYTHING = {
    "second_order_jets": {"disturbances.jets.force_scale": {"l_arm_jet": 0.9}, "controller.axes_of": "chest"},
    "robot": {
        "controller.torque.friction": {"torso": 0.5},
        "controller.fault_detection.joints": False,
        "simulator.motors.elasticity": {"stiffness": 1000.0, "damping": 2.0},
        "simulator.sensors.wind_preview": 0.8,
        "disturbances.model_error.mass_scale": 1.1,
        "disturbances.controller_wind": {"profile": "constant", "velocity": [0.0, -8.0, 0.0]},
        "disturbances.wind_estimate": {"mean_only": True},
        "disturbances.joints": [{"joint": "l_elbow", "kind": "weak", "start": 0.0}],
        "disturbances.pushes": [{"body": "chest", "force": [1.0, 0.0, 0.0], "start": 0.0, "duration": 1.0}],
    },
    "test1_policy": {},
    "robustness": {},
}
"""Flights that together have every part that JAX can fly, by experiment and changes."""


@cache
def shapes(experiment):
    """A scenario and its state as shapes, which are enough: nothing is computed."""
    config = scenario_config(rust.load_config(experiment, EVERYTHING[experiment]))
    robot, card = load_robot(config.robot), getattr(config.simulator.aero, "card", None)
    network = load_network(card, robot) if card else None
    return jax.eval_shape(lambda: sim.prepare(config, read_network=lambda *_: network))


def absent(tree):
    """Names of the optional parts that a scenario lacks, and of those that it has."""
    fields = [item.name for item in dataclasses.fields(tree)] if dataclasses.is_dataclass(tree) else []
    for name in fields or getattr(tree, "_fields", ()):
        part = getattr(tree, name)
        yield f"{type(tree).__name__}.{name}", part is None
        yield from absent(part)


def test_the_flights_have_every_part():
    lacking = [dict(absent(shapes(experiment)[0])) for experiment in EVERYTHING]
    found = {name for each in lacking for name in each if all(other.get(name, True) for other in lacking)}
    assert found == set()


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EVERYTHING)
def test_a_tick_of_many_flights(experiment):
    """The whole closed loop: controller, both QPs, plant, jets."""
    flight, state = shapes(experiment)
    states = jax.tree.map(lambda x: jax.ShapeDtypeStruct((BATCH, *x.shape), x.dtype), state)

    def tick(flight, states):
        return jax.vmap(sim.step, in_axes=(None, 0, None))(flight, states, jnp.array(3))

    found = lapack_batches(tick, flight, states)
    assert len(found) > 5
    assert max(found) <= CHUNK


def test_an_inverse_that_is_known_is_not_computed():
    rng = np.random.default_rng(0)
    root, is_known = rng.normal(size=(40, 3, 3)), np.arange(40) % 3 == 0
    matrices, known = root @ np.swapaxes(root, 1, 2) + np.eye(3), rng.normal(size=(40, 3, 3))
    found = jax.jit(jax.vmap(lambda a, *unless: invert(a, unless)))(matrices, is_known, known)
    expected = np.where(is_known[:, None, None], known, np.linalg.inv(matrices))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_gradients_of_many_samples():
    """The only functions that call LAPACK; nothing else that a tick differentiates contains such a kernel."""
    n = 5
    matrix, vector = jnp.zeros((BATCH, n, n)), jnp.zeros((BATCH, n))

    def accelerations(matrix, vector):
        return jnp.sum(jax.vmap(solve_positive_definite)(matrix, vector[:, :, None]) ** 2)

    def inverses(matrix, vector):
        return jnp.sum(jax.vmap(lambda a, b: invert(a, unless=(b[0] > 0.0, a)))(matrix, vector) ** 2)

    def commands(matrix, vector):
        answers = jax.vmap(lambda h, g: qp.solve(qp.BoxQp(h, g, g - 1.0, g + 1.0)).x)(matrix, vector)
        return jnp.sum(answers**2)

    for cost in (accelerations, inverses, commands):
        found = lapack_batches(jax.grad(cost, argnums=(0, 1)), matrix, vector)
        assert len(found) > 1
        assert max(found) <= CHUNK
