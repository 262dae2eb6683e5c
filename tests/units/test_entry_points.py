"""What `import jax_aero` gives, and what it does not import."""

import subprocess
import sys

import numpy as np
import pytest

import jax_aero
from jax_aero.base.places import HOME
from jax_aero.body.jets import JetsState
from jax_aero.types import pytree, replace_values


@pytree
class Outer:
    jets: JetsState
    gain: float


@pytest.mark.parametrize("name", jax_aero.__all__)
def test_every_name_is_there(name):
    assert getattr(jax_aero, name) is not None
    assert name in dir(jax_aero)


def test_the_crate_flies_without_jax():
    code = (
        "import sys, jax_aero; config = jax_aero.load('test2', {'simulator.duration': 0.1});"
        "print(jax_aero.fly(config).outcome, {'jax', 'scipy', 'mujoco', 'xarray'} & set(sys.modules))"
    )
    answer = subprocess.run([sys.executable, "-c", code], cwd=HOME, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "completed set()"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute `flown`"):
        jax_aero.flown  # noqa: B018


def test_numbers_change_by_dotted_names():
    before = Outer(JetsState(np.ones(4), np.zeros(4)), np.float32(2.0))
    after = replace_values(before, {"jets.thrust": np.full(4, 3.0), "gain": 5.0})
    assert list(after.jets.thrust) == [3.0] * 4
    assert float(after.gain) == 5.0
    assert after.gain.dtype == np.float32
    assert list(before.jets.thrust) == [1.0] * 4
