"""Every intermediate value of stored ticks, to 1e-9 of the largest entry of each array."""

import numpy as np
import pytest

from jax_aero import rust
from tests.golden import flights, ticks

NAMES = [f"{name}_{row}" for name, rows in ticks.INSTANTS.items() for row in rows]


def tolerance(key, expected):
    """Torques are as certain as their QP is conditioned: some operations, each rounded."""
    if key not in {"unlimited_torque", "joint_torque", "contact.force_of_torques"}:
        return flights.DOUBLE
    h = expected["torque_qp.h"]
    root = np.sqrt(h.diagonal())
    return max(flights.DOUBLE, 10.0 * np.finfo(float).eps * np.linalg.cond(h / np.outer(root, root)))


@pytest.mark.parametrize("name", NAMES)
def test_a_tick_is_the_stored_one(name):
    given, expected = ticks.load_stored(name)
    found = ticks.compute(rust.load_config(name.rpartition("_")[0]), given)
    assert set(found) == set(expected)
    wrong = {}
    for key, value in expected.items():
        worst = flights.difference(found[key][None], value[None])[0]
        if not worst <= tolerance(key, expected):
            wrong[key] = f"{worst:.1e}"
    assert not wrong
