"""The C library gives the commands of the crate, bit by bit; those of another configuration disagree."""

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.verify import library

LIBRARY = library.find()
SHORT = {"simulator.duration": 0.3}
pytestmark = pytest.mark.skipif(LIBRARY is None, reason="libflight is not built: make test")


def test_commands_of_another_configuration_disagree():
    flown, other = rust.fly(rust.load_config("test2", SHORT)), rust.load_config("test1", SHORT)
    found = library.commands(other, flown, LIBRARY)
    torque = np.array([command["joint_torque"] for command in found])
    assert np.abs(torque - flown["joint_torque"]).max() > 1e-6


def test_what_no_log_has_is_not_compared(tmp_path):
    assert "torque.steps" in library.why_not(rust.load_config("robot", {"controller.torque.steps": 10}))
    with pytest.raises(OSError, match="nowhere"):
        library.verify_library(rust.load_config("test2", SHORT), tmp_path / "nowhere.so")
