"""A quadrotor's public logs: their columns as ours, and what is said where they cannot be had."""

from __future__ import annotations

import urllib.request

import numpy as np
import pandas as pd
import pytest

from experiments.studies.nano_drone import study
from jax_aero.base import places
from jax_aero.base.terminal import Refused


def test_columns_are_ours():
    """Turned a quarter about z, a rate about the base's x is one about y; glitches are not measured."""
    half = np.sqrt(0.5)
    row = dict.fromkeys(("t", "x", "y", "z", "vx", "vy", "vz", "qx", "qy", "wy", "wz"), 0.0)
    row |= {"qz": 1.01 * half, "qw": 1.01 * half, "wx": 2.0} | {f"{name}_erpm": 1e5 for name in study.CORNERS}
    found = study.converted(pd.DataFrame([row, row | {"m2_erpm": 6e6}]))
    np.testing.assert_allclose(found[["ax", "ay", "az"]].to_numpy()[0], [0.0, 2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[["qx", "qy", "qz", "qw"]].to_numpy()[0], [0.0, 0.0, half, half], atol=1e-12)
    speed = 1e5 / study.POLES * 2.0 * np.pi / 60.0
    assert found["thrust_m1"][1] == pytest.approx(study.THRUST * speed**2)
    assert np.isnan(found["thrust_m2"][1])


def test_flights_that_cannot_be_fetched_are_named(monkeypatch, tmp_path):
    def closed(*_, **__):
        raise OSError("no network")

    monkeypatch.setattr(places, "RESULTS", tmp_path)
    monkeypatch.setattr(urllib.request, "urlopen", closed)
    with pytest.raises(
        Refused, match=r"melon_20251017_run5.parquet` is not there and cannot be fetched .* \(no network\)"
    ):
        study.fetch(study.FLIGHTS[2])
