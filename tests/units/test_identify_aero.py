"""Identification of the air's coefficients along a flight: its descent, on a misfit whose minimum is known."""

import numpy as np

from jax_aero import identify


def test_the_descent_ends_at_the_minimum_of_what_exists():
    wanted = np.array([[0.3, -0.2], [0.1, 0.4]])
    exists = np.array([[True, False], [True, True]])
    found, losses = identify.descend(lambda theta: ((theta - wanted) ** 2).sum(), exists, steps=300, rate=0.05)
    # The rate falls to zero by a cosine: what is left after 300 steps is far below a coefficient's own uncertainty.
    np.testing.assert_allclose(found, wanted * exists, atol=1e-3)
    np.testing.assert_allclose(losses[[0, -1]], [(wanted**2).sum(), wanted[0, 1] ** 2], rtol=1e-3)
