"""The study of airs that are learnt: its worlds and its figure of merit."""

import numpy as np
import pytest
import xarray as xr

from experiments.studies.learnt_air import figure, study, worlds
from jax_aero import rust
from jax_aero.aero.network_card import load_network
from jax_aero.body.robot import load_robot
from jax_aero.train import refit


@pytest.fixture(scope="module")
def robot():
    return load_robot(rust.load_config("test2")["robot"])


def test_merit_is_the_share_of_the_way_from_the_nominal_to_the_true_air():
    """A flight that is lost is the worst: with most lost, no median is finite and there is no merit."""
    errors = {
        "nominal": np.full(9, 10.0),
        "learnt": np.full(9, 4.0),
        "refit": np.array([np.inf] * 4 + [2.0] * 5),
        "true": np.full(9, 2.0),
    }
    found = study.merit(errors, np.random.default_rng(0))
    assert found["learnt, merit"] == found["learnt, merit from"] == found["learnt, merit to"] == 0.75
    assert found["refit, merit"] == 1.0
    assert found["refit, lost"] == 4
    lost = study.merit(errors | {"learnt": np.array([np.inf] * 5 + [2.0] * 4)}, np.random.default_rng(0))
    assert lost["learnt, merit"] == -np.inf


def test_an_anemometer_errs_as_it_is_said(robot):
    """Noise, a bias of one length, late by five ticks; 0.8 of it where the air comes from behind."""
    forward, count = np.asarray(robot.forward_axis), 4000
    time = 0.01 * np.arange(count)
    wind = np.zeros((count, 3))
    wind[:, :2] = -8.0 * forward[:2]  # from ahead
    wind[2000:, :2] *= -1.0
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    read = worlds.misread({"time": time, "raw_wind": wind, "base_quaternion": upright}, 3, 1, forward)["raw_wind"]
    bias = np.asarray(worlds.errors_of(3, 1)["bias"])
    assert np.linalg.norm(bias) == pytest.approx(1.0)
    np.testing.assert_allclose(read[:2000].mean(axis=0), wind[0] + bias, atol=0.05)
    np.testing.assert_allclose(read[2005:].mean(axis=0), 0.8 * (wind[-1] + bias), atol=0.05)
    assert read[:2000].std(axis=0) == pytest.approx(0.5, rel=0.1)
    assert np.linalg.norm(read[2003] - 0.8 * (wind[0] + bias)) < 3.0, "the wind of five ticks ago, in the wake of now"
    assert not np.array_equal(worlds.errors_of(3, 2)["bias"], bias)


def test_flights_that_judge_are_the_same_for_all_models(robot):
    one, other = (
        worlds.judging("test2", "turbulence", 5, 3, rust.load_config("test2")["simulator"]["aero"], model)
        for model in ({"model": "off"}, rust.load_config("test2")["controller"]["aero"])
    )
    assert one["wind"] == other["wind"]
    assert one["simulator"] == other["simulator"]
    assert (
        worlds.judging("test2", "gust", 5, 3, one["simulator"]["aero"], {"model": "off"})["wind"]["profile"] == "gust"
    )
    assert one["controller"]["aero"] != other["controller"]["aero"]


def test_flights_to_learn_from_have_no_model_and_come_from_all_sides(tmp_path, robot):
    air = rust.load_config("test2")["simulator"]["aero"]
    flights = [worlds.learning(1, number, 4, air, "mixed", tmp_path) for number in range(4)]
    assert all(flight["controller"]["aero"] == {"model": "off"} for flight in flights)
    angles = [np.arctan2(*flight["wind"]["velocity"][1::-1]) % (2.0 * np.pi) for flight in flights]
    assert np.floor(np.array(angles) / (0.5 * np.pi)).tolist() == [0, 1, 2, 3]
    assert flights[0]["mission"] != flights[1]["mission"]
    excited = worlds.learning(1, 0, 4, air, "excited", tmp_path)
    assert np.genfromtxt(excited["mission"]["file"], delimiter=",", names=True)["yaw"].std() > 0.02
    assert flights[0]["disturbances"]["model_error"] != flights[1]["disturbances"]["model_error"]


def test_an_air_of_another_family_is_another_network(tmp_path, robot, monkeypatch):
    from msgspec import structs

    monkeypatch.setattr(worlds, "OTHER", structs.replace(worlds.OTHER, epochs=2, validate_every=2))
    table = worlds.air_of("other", robot, tmp_path)
    card = rust.read_network(table["card"], robot.joint_names, robot.aero_links.names)
    assert (card["blocks"], card["frame"], card["activation"], card["mirror"]) == (
        ("wind", "joints"),
        "base",
        "tanh",
        False,
    )
    assert worlds.air_of("spheres", robot, tmp_path)["model"] == "sphere_cylinder"


def test_a_model_is_judged_by_its_wrench_and_in_flight_and_the_true_air_errs_in_neither(tmp_path, robot):
    asked = study.LearntAir(air="shipped", winds=2, minutes=(2.0,), seed=3)
    air = worlds.air_of("shipped", robot, tmp_path)
    judges = [study.Record(worlds.learning(3, 0, 1, air, "hover", tmp_path), robot, "judge")]
    same = load_network(air["card"], robot)
    found = study._judged_alone(asked, same, air, judges, robot, tmp_path)
    true = study._judged_alone(asked, None, air, judges, robot, tmp_path)
    nothing = refit.as_network(robot, np.zeros((robot.aero_links.count, refit.TERMS)))
    none = study._judged_alone(asked, nothing, air, judges, robot, tmp_path)
    assert true["force [N]"] == true["moment [N m]"] == 0.0
    assert found["force [N]"] < 0.01 * none["force [N]"], "velocities have the noise of sensors"
    assert found["rotation [degree]"] == pytest.approx(true["rotation [degree]"], rel=1e-3)
    assert none["rotation [degree]"] > 2.0 * true["rotation [degree]"]


def test_forces_that_lag_are_behind_those_of_the_air_by_a_time_constant(robot):
    gust = {"profile": "gust", "velocity": [0.0] * 3, "gust": [0.0, -10.0, 0.0], "start": 0.5, "duration": 2.0}
    config = rust.load_config("test2", {"simulator.duration": 1.5, "wind": gust})
    forward = np.asarray(robot.forward_axis)
    exact, late = (worlds.fly(config, None, forward, lag).log["aero_force_sim"].sum(1)[:, 1] for lag in (0.0, 0.1))
    assert late[80] / exact[80] < 0.5
    rise = 10.0 * np.diff(late)  # lag · ḟ, of a lag of ten ticks
    np.testing.assert_allclose(rise[60:90], (exact - late)[61:91], rtol=0.01)  # as long as both robots move alike


def test_a_recommended_controller_flies_with_a_network_and_in_an_air_without_derivatives(robot):
    """Its plan then holds the forces constant, with every model."""
    spheres = worlds.air_of("spheres", robot, None)
    for law in ("robot", "mk3_robot"):
        for model in (rust.load_config(law)["controller"]["aero"], spheres):
            assert worlds.judging(law, "gust", 1, 0, spheres, model)["controller"]["mpc"]["air"] == "constant"


def test_the_picture_has_a_line_for_each_kind_and_model_and_the_levels_beside_them():
    kinds, minutes = ["mission", "hover"], [2.0, 4.0]
    error = np.arange(12.0).reshape(2, 2, 3)
    measures = dict.fromkeys(figure.LABELS, (("kind", "minutes", "model"), error))
    levels = {f"{key}_line": ("line", [20.0, 0.5]) for key in figure.LABELS}
    coords = {"kind": kinds, "minutes": minutes, "model": list(study.LEARNERS), "line": ["nominal", "true"]}
    axes = figure.draw(xr.Dataset(measures | levels, coords)).axes[0]
    drawn = {line.get_label(): list(line.get_ydata()) for line in axes.lines}
    assert drawn["hover: refit"] == error[1, :, 2].tolist()
    assert [20.0, 20.0] in drawn.values()
