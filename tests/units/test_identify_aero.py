"""Identification of the air's coefficients along a flight: its misfit, and the descent to a minimum that is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero import rust, sim
from jax_aero.base.typed import scenario_config
from jax_aero.train import identify


@pytest.mark.usefixtures("x64")
def test_the_misfit_is_that_of_velocities_and_of_the_prior(measured):
    """The coefficients that were flown leave none of the velocities; what others are off the prior is a plain sum."""
    config = rust.load_config("test2", {"simulator.duration": 0.5, "wind.ramp_start": -1.0, "wind.ramp_end": 0.0})
    scenario, _ = sim.prepare(scenario_config(config))
    plant = scenario.plant
    segments = identify.segments_of(rust.fly(config).log, first_tick=5, count=2, horizon=3)
    families, member = np.unique(np.asarray(plant.aero.areas), axis=0, return_inverse=True)
    theta = np.full(families.shape, 0.1)

    @jax.jit
    def misfit(deviation, theta):
        scale = jnp.full(segments.velocity.shape[1], deviation)
        return identify.misfit_of(plant, plant.aero, segments, member.ravel(), scale, 0.5)(theta)

    # Velocities of both engines agree to 1e-12 after a few ticks.
    measured("misfit of what was flown", float(misfit(1e-9, 0.0 * theta)), 1e-4)
    prior = 0.5 * np.sum((theta / 0.5) ** 2) / segments.velocity.size
    assert misfit(1e-3, theta) - prior > 1e-3
    measured("prior", abs(float(misfit(1e9, theta)) - prior), 1e-12)


def test_the_descent_ends_at_the_minimum_of_what_exists():
    wanted = np.array([[0.3, -0.2], [0.1, 0.4]])
    exists = np.array([[True, False], [True, True]])
    found, losses = identify.descend(lambda theta: ((theta - wanted) ** 2).sum(), exists, steps=300, rate=0.05)
    # The rate falls to zero by a cosine: what is left after 300 steps is far below a coefficient's own uncertainty.
    np.testing.assert_allclose(found, wanted * exists, atol=1e-3)
    np.testing.assert_allclose(losses[[0, -1]], [(wanted**2).sum(), wanted[0, 1] ** 2], rtol=1e-3)
