"""Names of joints and links."""

from __future__ import annotations

import pytest

from jax_aero.body.mirror import mirror_name


@pytest.mark.parametrize(
    ("name", "opposite"),
    [
        ("l_shoulder_pitch", "r_shoulder_pitch"),
        ("chest_l_jet_turbine", "chest_r_jet_turbine"),
        ("wing_left", "wing_right"),
        ("torso_roll", "torso_roll"),
        ("head", "head"),
    ],
)
def test_the_opposite_side_has_left_and_right_swapped(name, opposite):
    assert mirror_name(name) == opposite
    assert mirror_name(opposite) == name
