"""Failures beyond the sweeps: what a flight is judged by, and that every part flies."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from experiments.studies.failures import flights, ground
from experiments.studies.failures import study as failures
from jax_aero import rust
from jax_aero.base import places


def test_a_descent_is_flown_as_it_says(monkeypatch):
    """Every flight is one that can be configured; the first one is flown."""
    planned = []

    def fly(chosen, every):
        planned.extend(chosen)
        (first,) = rust.fly_batch([planned[0].config()], full_log=True)
        yield planned[0], first

    monkeypatch.setattr(flights, "fly", fly)
    (row,) = flights.descent(1)
    assert row["completed"]
    assert row.keys() <= failures.MEANING.keys()
    for failure in (planned[len(planned) // 2], planned[-1]):
        failure.config()
    assert len({(one.case, str(one.changes), one.controller is None) for one in planned}) == len(planned)


def test_a_result_has_the_flights_and_counts_of_its_part(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert failures.main(["descent", "--set", "every=12"]) == 0
    data = xr.load_dataset(tmp_path / "failures" / "descent--every=12" / "run.nc", engine="h5netcdf")
    assert data.sizes == {"flight": 3}
    assert data["found"].attrs["units"] == "s"
    assert "arm jet fades at 18 s 1 of 1 complete" in " ".join(capsys.readouterr().out.split())


def test_a_part_that_does_not_exist_is_refused(capsys):
    assert failures.main(["pause"]) == 2
    assert "there is no part `pause`; did you mean pauses?" in capsys.readouterr().err


def test_a_pause_is_a_gap_in_the_ticks(monkeypatch):
    monkeypatch.setattr(flights, "JERK", np.zeros(30))
    ticked = []
    tick = rust.Controller.tick
    monkeypatch.setattr(
        rust.Controller, "tick", lambda self, *seen, **to: ticked.append(seen[3]) or tick(self, *seen, **to)
    )
    assert flights.greatest_distance("test2_observer", 10, 5) < 0.1
    assert np.round(100.0 * np.array(ticked)).astype(int).tolist() == [*range(11), *range(15, 30)]


def test_a_flight_whose_thrusts_are_measured_too_high_falls(monkeypatch):
    monkeypatch.setattr(flights, "SHARES", (0.3,))
    growing, from_the_start = flights.thrust_scaled(1)
    assert not growing["completed"]
    assert not from_the_start["completed"]


def test_foot_sensors_are_lost_frozen_or_zero_from_a_time_on():
    feet = np.ones((2, 6))
    state = rust.State(np.zeros(3), np.eye(3), np.zeros(23), np.ones(29))
    unknown = np.full(4, np.nan)
    before, after = (rust.Measurement(t, state, np.ones(4), np.zeros(3), t * feet, unknown) for t in (1.0, 2.0))
    seen = {}
    for what in ("foot_wrenches", "frozen", "zero", "right", "velocity"):
        change = ground.mislead(what, 1.5)
        assert change(before) is before
        seen[what] = change(after)
    assert np.isnan(seen["foot_wrenches"].foot_wrenches).all()
    assert (seen["frozen"].foot_wrenches == feet).all()
    assert (seen["zero"].foot_wrenches == 0.0).all()
    assert seen["right"] is after
    assert np.isnan(seen["velocity"].state.velocity[:6]).all()
    assert (seen["velocity"].state.velocity[6:] == 1.0).all()


@pytest.mark.filterwarnings("ignore:disturbances")  # of flights that end before what they are for
@pytest.mark.parametrize("part", ground.PARTS)
def test_a_part_on_the_ground_flies(part, monkeypatch):
    monkeypatch.setattr(ground, "DURATION", 0.05)
    rows = ground.PARTS[part](40)
    assert all(row["completed"] for row in rows)
