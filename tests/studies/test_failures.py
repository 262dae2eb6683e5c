"""Failures beyond the sweeps: what a flight is judged by, and that every part flies."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from experiments.studies.failures import flights, ground
from experiments.studies.failures import study as failures
from jax_aero import places, rust
from jax_aero.control.modes import MODES


def test_a_flight_is_judged_from_the_failure_on(make_flight, agree):
    flight = make_flight(duration=5.0)
    time = flight["time"]
    flight.log["rotation_error"] = np.where(time < 2.0, 1.0, 0.1)
    flight.log["degraded_modes"] = np.where((time < 1.0) | (time > 2.95), MODES["thrust_modelled"], 0)
    row = flights.judge(flights.Failure("a", "test2_observer", 2.0, {}), flight)
    agree("lean", row["lean"], np.degrees(0.1), 1e-12)
    agree("found", row["found"], 1.0, 1e-9)
    assert row["completed"]


@pytest.mark.parametrize("part", ["losses", "planned", "thrust", "thrust_checked", "engines", "descent"])
def test_a_part_by_the_crate_flies_what_it_says(part, monkeypatch):
    """Every flight of every part is one that can be configured; the first one is flown."""
    planned = []

    def fly(chosen, every):
        planned.extend(chosen)
        (first,) = rust.fly_batch([planned[0].config()], full_log=True)
        yield planned[0], first

    monkeypatch.setattr(flights, "fly", fly)
    (row,) = flights.PARTS[part](1)
    assert row["completed"]
    assert row.keys() <= failures.MEANING.keys()
    for failure in (planned[len(planned) // 2], planned[-1]):
        failure.config()
    assert len({(one.case, str(one.changes), one.controller is None) for one in planned}) == len(planned)


def test_a_result_has_the_flights_and_counts_of_its_part(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert failures.main(["thrust", "--set", "every=26"]) == 0
    data = xr.load_dataset(tmp_path / "failures" / "thrust--every=26" / "run.nc", engine="h5netcdf")
    assert data.sizes == {"flight": 2}
    assert float(data["lean"].max()) < 30.0
    assert data["found"].attrs["units"] == "s"
    assert "test2_observer, arm, 90.0: 1 of 1 complete" in capsys.readouterr().out


def test_a_part_that_does_not_exist_is_refused(capsys):
    assert failures.main(["losse"]) == 2
    assert "there is no part `losse`; did you mean losses?" in capsys.readouterr().err


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
    before, after = (ground.Seen(time, state, np.ones(4), time * feet) for time in (1.0, 2.0))
    seen = {}
    for what in ("foot_wrenches", "frozen", "zero", "right", "velocity"):
        change = ground.mislead(what, 1.5)
        assert change(before) is before
        seen[what] = change(after)
    assert np.isnan(seen["foot_wrenches"].feet).all()
    assert (seen["frozen"].feet == feet).all()
    assert (seen["zero"].feet == 0.0).all()
    assert seen["right"] is after
    assert np.isnan(seen["velocity"].state.velocity[:6]).all()
    assert (seen["velocity"].state.velocity[6:] == 1.0).all()


@pytest.mark.parametrize("part", ground.PARTS)
def test_a_part_on_the_ground_flies(part, monkeypatch):
    monkeypatch.setattr(ground, "DURATION", 0.05)
    rows = ground.PARTS[part](40)
    assert all(row["completed"] for row in rows)


def test_an_engine_that_stops_gives_no_thrust():
    plant = ground.Failing(rust.load_config("take_off"), jet=1, after=2)
    thrust = [plant.advance(np.zeros(23), np.full(4, 100.0)) or plant.thrust.copy() for _ in range(3)]
    assert thrust[0][1] > 0.0
    assert thrust[1][1] == thrust[2][1] == 0.0
    assert thrust[2][0] > thrust[0][0]
