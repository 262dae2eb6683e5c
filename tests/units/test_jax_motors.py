"""Drives in JAX: a batch in which some searches go on is that of its samples, with the inverse of what was found."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.sim.motors import Motors, MotorsState
from jax_aero.types import InverseMass, State

pytestmark = pytest.mark.usefixtures("x64")

STEP, N, SAMPLES = 1e-3, 5, 20
"""More samples than one call of LAPACK has."""


def samples():
    """Return states of drives with dry friction, and what acts on them."""
    rng = np.random.default_rng(7)
    factor = 0.1 * rng.normal(size=(SAMPLES, N, N))
    inertia = factor @ factor.swapaxes(1, 2) + 0.05 * np.eye(N)
    zero = np.zeros((SAMPLES, N))
    inverse = InverseMass(
        np.tile(np.eye(6), (SAMPLES, 1, 1)), np.zeros((SAMPLES, 6, N)), inertia, np.full_like(inertia, np.nan)
    )
    velocity = rng.normal(scale=0.05, size=(SAMPLES, 6 + N))
    joints = State(np.zeros((SAMPLES, 3)), np.tile(np.eye(3), (SAMPLES, 1, 1)), zero, velocity)
    slip = np.sign(velocity[:, 6:]) * (rng.uniform(size=(SAMPLES, N)) < 0.7)
    state = MotorsState(zero, np.ones(SAMPLES, bool), zero, velocity[:, 6:], slip, np.full((SAMPLES, N), 2.0))
    torque, force = rng.normal(scale=4.0, size=(SAMPLES, N)), rng.normal(scale=4.0, size=(SAMPLES, 6 + N))
    return jax.tree.map(jnp.asarray, (state, torque, joints, inverse, force))


def drives():
    numbers = {"friction": np.full(N, 2.0), "load_friction": np.zeros(N), "damping": 0.3, "inertia": 0.01}
    return Motors(**jax.tree.map(jnp.asarray, numbers | {"time_constant": 0.0}), spring=None)


def test_a_batch_is_that_of_its_samples():
    """Half of the searches end with their first signs, while the others go on."""
    motors, given = drives(), samples()

    def one(*of):
        return motors.drive(*of, jnp.asarray(STEP))

    together, alone = jax.jit(jax.vmap(one)), jax.jit(one)
    is_found = (np.arange(SAMPLES) % 2 == 0)[:, None]
    given = given[0]._replace(slip=jnp.where(is_found, together(*given).slip, given[0].slip)), *given[1:]
    batch = together(*given)
    for index in range(SAMPLES):
        sample, of = (jax.tree.map(lambda leaf: leaf[index], part) for part in (batch, given))  # noqa: B023
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-11), sample, alone(*of))
    changed = np.any(np.asarray(batch.slip != given[0].slip), axis=1)
    assert changed.any()
    assert not changed.all()
    # The inverse is that of the inertia with the drives as they were found, whatever that without them was (NaN).
    inverse = batch.inverse_mass
    inertia = given[3].joint_inertia + jax.vmap(jnp.diag)(STEP * batch.reaction.slope)
    np.testing.assert_allclose(inverse.joint_inertia, inertia, rtol=1e-14)
    eyes = np.broadcast_to(np.eye(N), inertia.shape)
    tolerance = 2 * N * np.finfo(float).eps * np.linalg.cond(inertia).max()
    np.testing.assert_allclose(inverse.joint_gain @ inertia, eyes, rtol=0.0, atol=tolerance)


def test_slope_by_damping():
    """In both modes and in a batch, against a difference of two flights with the same signs."""
    motors, given = drives(), samples()

    def size(damping, *of):
        driven = dataclasses.replace(motors, damping=damping).drive(*of, jnp.asarray(STEP))
        return jnp.sum(driven.inverse_mass.joint_gain) + jnp.sum(driven.force)

    every = jax.vmap(size, in_axes=(None, 0, 0, 0, 0, 0))
    total = jax.jit(lambda damping: jnp.sum(every(damping, *given)))
    at, by = jnp.asarray(0.3), 1e-4
    backward, forward = jax.jit(jax.grad(total))(at), jax.jit(jax.jacfwd(total))(at)
    difference = (total(at + by) - total(at - by)) / (2 * by)
    np.testing.assert_allclose(backward, forward, rtol=1e-11)
    # Of the difference: its own rounding, and its term of third order.
    np.testing.assert_allclose(backward, difference, rtol=1e-6)
