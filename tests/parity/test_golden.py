"""Two states of a tick that `tests/golden/states.py` computed without the crate, through the bindings."""

import json

import numpy as np
import pytest

from jax_aero import rust
from tests.golden import ticks
from tests.golden.inputs import AERO, FILE, TORQUE_MAX

TOLERANCE = 1e-9
"""Of the largest entry of each array; both sides round terms of condition up to 1e5."""

STATES = json.loads(FILE.read_text(encoding="utf-8"))["states"]


@pytest.fixture(params=STATES, ids=["four bounds active", "torque bounds active"])
def golden(request):
    return {part: {key: np.array(value) for key, value in values.items()} for part, values in request.param.items()}


@pytest.mark.parametrize("controller", ["aero_aware", "baseline"])
def test_every_value_of_a_tick(golden, controller, agree):
    experiment = {"aero_aware": "test2", "baseline": "test1"}[controller]
    config = rust.load_config(experiment)
    if controller in AERO:
        config["controller"]["aero"] = rust.load_aero(AERO[controller])
    config["controller"]["torque"]["torque_max"] = TORQUE_MAX
    found = ticks.compute(config, golden["given"] | {"time": 0.0})
    expected = golden[controller]
    expected.pop("link_jacobians", None)
    for key, value in expected.items():
        agree(key, found[key], value, TOLERANCE)
