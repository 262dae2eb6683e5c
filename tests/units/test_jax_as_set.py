"""JAX as its users set it: a sound flight raises nothing, and is the same."""

import os
import subprocess
import sys

import pytest

FLY = """
import numpy as np
from jax_aero import load, rust, sim
config = load("test2", {"simulator.duration": 0.05})
flown = sim.fly(config)
assert flown.outcome == "completed", flown
assert np.isnan(flown["raw_shaft_speed"]).all()  # JAX has no shafts
assert list(flown.log) == list(rust.fly(config).log)
np.testing.assert_allclose(flown["base_position"], rust.fly(config)["base_position"], atol=1e-9)
"""


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{"JAX_DEBUG_NANS": "True"}, {"JAX_ENABLE_X64": "True"}])
def test_a_sound_flight_is_sound(settings):
    words = [sys.executable, "-c", FLY]
    answer = subprocess.run(words, env=os.environ | settings, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr[-2000:]
