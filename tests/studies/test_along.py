"""Fuel and clearance along a flight; pictures and the drawing of the tunnel from a study made up."""

import numpy as np
import pytest

from experiments.studies.along import study as along
from jax_aero import rust
from jax_aero.base import places, tables
from jax_aero.base.files import write_netcdf
from jax_aero.base.places import ROBOT
from jax_aero.base.terminal import Refused
from jax_aero.figures.catalogue import FIGURES
from jax_aero.figures.runs import NotDrawn
from jax_aero.results import record
from jax_aero.symbolic import load_robot
from jax_aero.symbolic.trajectory import Consumption

POSTURE = [0.1, *[0.0] * 2, *[-0.17, 0.44, 0.7, 0.26] * 2, *[0.0] * 12]


def fuel():
    points = {"thrust": [0.0, 100.0], "consumption": [0.06, 0.36]}
    return {jet.name: tables.convert(points, Consumption, "here") for jet in load_robot(ROBOT).jets}


def test_fuel_is_the_integral_of_idle_and_thrust(agree):
    times = np.array([0.0, 1.0, 3.0])
    thrust = np.array([[10.0, 0.0], [10.0, 0.0], [10.0, 40.0]])
    burnt = along.fuel_burnt(times, thrust, np.array([0.5, 0.25]), np.array([0.1, 0.2]))
    # 1.75 l/s over the first second; then up to 9.75 l/s over two, by a trapezoid.
    agree("fuel", burnt, [0.0, 1.75, 1.75 + 0.5 * (1.75 + 9.75) * 2.0], 1e-14)


def test_a_flight_that_is_not_there_is_named():
    with pytest.raises(Refused, match="no flight `nowhere`; fly it with: jax-aero fly nowhere"):
        along._read("nowhere")


def test_a_flight_that_is_cut_short_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(along.places, "RESULTS", tmp_path)
    path = tmp_path / "flight" / "cut" / "run.nc"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(Refused, match=r"cut/run\.nc is damaged \("):
        along._read("cut")


@pytest.fixture
def study(make_flight, robot):
    runs = {}
    for name, lost in (("whole", None), ("fell", 21.5), ("short", None)):
        flight = make_flight(30.0 if name == "short" else 50.0, step=0.5, lost_time=lost)
        flight.log["thrust"][:] = 100.0
        flight.log["joint_position"][:] = POSTURE
        runs[name] = record.to_dataset(flight, robot, title=name, config_digest="0")
    return along.fuel_and_clearance(runs, fuel(), 1.5)


def test_a_flight_of_another_robot_is_named(make_flight, robot):
    platform = record.to_dataset(make_flight(), robot, title="t", config_digest="0").isel(joint=slice(4))
    with pytest.raises(Refused, match="`flights` has mine, whose joints are not those of "):
        along.fuel_and_clearance({"mine": platform}, fuel(), 1.5)


def test_figures_of_a_flight_end_with_it(study, agree):
    found = along.figures(study)
    # Four jets at 100 N burn 0.36 l/min each.
    agree("fuel", found["whole"]["fuel_l"], 4 * 0.36 / 60.0 * 50.0, 1e-9)
    agree("fuel until the fall", found["fell"]["fuel_l"], 4 * 0.36 / 60.0 * 21.5, 1e-9)
    agree("five minutes", found["whole"]["five_minutes_kg"], 4 * 0.36 * 5.0 * 0.8, 1e-9)
    assert np.isnan(study["clearance"].sel(flight="fell", time=30.0)).all()


def test_the_nearest_link_of_the_papers_posture_is_the_pelvis(measured):
    joints = np.array(rust.load_config("configs/experiments/test2.toml")["simulator"]["initial"]["joint_position"])
    distances, jets = along.clearance_of(load_robot(ROBOT), 1.5)
    values = distances(joints).full().ravel()
    assert jets[int(values.argmin())].startswith("chest")
    measured("clearance", abs(values.min() - 0.0352), 2e-4, because="typed to the digits that are allowed")


def test_the_figure_shows_flights(study, tmp_path):
    study.attrs["config_hash"] = "0"
    folder = tmp_path / "along" / "flights"
    folder.mkdir(parents=True)
    write_netcdf(folder / "run.nc", study)
    figure, hashes = FIGURES["along"].draw_from_results(tmp_path)
    # A cross where the one was lost and in the legend, none where the other was shorter; as published the line at zero.
    assert [len(axes.lines) for axes in figure.axes] == [5, 5, 1]
    assert hashes == {"flights": "0"}


def test_a_result_of_older_code_is_not_drawn(study, tmp_path):
    folder = tmp_path / "along" / "flights"
    folder.mkdir(parents=True)
    write_netcdf(folder / "run.nc", study.drop_vars("lost_time").assign_attrs(config_hash="0"))
    with pytest.raises(NotDrawn, match=r"'lost_time': other code made the result; make it again: jax-aero study along"):
        FIGURES["along"].draw_from_results(tmp_path)


def test_the_flights_themselves_count(make_flight, robot, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    path = tmp_path / "flight" / "mine" / "run.nc"
    path.parent.mkdir(parents=True)
    write_netcdf(path, record.to_dataset(make_flight(5.0), robot, title="t", config_digest="0"))
    assert path in along.compute("flights", along.Along(flights=("mine",))).files


def test_what_it_cannot_be_made_of_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert along.main(["--set", "flights=[]"]) == 2
    assert "`flights` is []; expected one value or more, each once" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
