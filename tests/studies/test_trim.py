"""Trims are equilibria of the Rust plant, within limits, and say what is in the way where there is none."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from experiments.studies.trim import figure
from experiments.studies.trim import study as experiment
from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.terminal import Refused
from jax_aero.figures.catalogue import FIGURES
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.symbolic.trim import Trim, TrimSettings
from tests.measurements import measured

ROOT = Path(__file__).resolve().parents[2]
SIDE_WIND = (0.0, -10.0, 0.0)


@pytest.fixture(scope="module")
def held():
    return experiment.build(experiment.STUDY.read("hover_posture")[1])


@pytest.fixture(scope="module")
def free():
    return experiment.build(experiment.STUDY.read("free_joints")[1])


@pytest.fixture(scope="module")
def flight():
    return rust.load_config("test2")


def rust_imbalance(flight, result, wind, velocity=(0.0, 0.0, 0.0)):
    """What the crate makes of a trim: the momentum rate [N, N m] and the joint accelerations [rad/s²]."""
    rotation = Rotation.from_euler("xyz", result.base_rpy).as_matrix()
    state = rust.State(np.zeros(3), rotation, result.joint_position, [*velocity, *np.zeros(26)])
    tick = rust.Controller(flight).tick(state, result.thrust, wind)
    return tick.momentum_rate_estimate, tick.joint_acceleration_free + tick.torque_gain @ result.joint_torque


@pytest.mark.close_to_tolerance("expected figures are typed to the digits that the tolerance allows")
def test_the_hover_of_the_papers_posture(held, measured):
    """The published start, 98 N in each arm, is the trim for the arms; in the chest it is 10 N short of the weight."""
    result = held.solve((0.0, 0.0, 0.0))
    assert result.feasible, result.message
    np.testing.assert_allclose(result.thrust, [97.92, 97.27, 123.35, 122.92], atol=0.01)
    np.testing.assert_allclose(np.degrees(result.base_rpy), [-0.023, -2.142, 180.0], atol=1e-3)
    assert abs(result.thrust[:2] - 98.0).max() < 1.0
    measured("clearance", abs(result.clearance - 0.0352), 2e-4)
    np.testing.assert_array_equal(result.joint_position, held.settings.posture)


@pytest.mark.parametrize("objective", experiment.OBJECTIVES)
@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), SIDE_WIND, (-17.0, 0.0, 0.0), (6.0, 9.0, 2.0)])
def test_a_trim_is_an_equilibrium_of_the_rust_plant_within_all_limits(free, flight, wind, objective, agree):
    result = free.solve(wind, objective=objective)
    assert result.feasible, result.message
    for imbalance in rust_imbalance(flight, result, wind):
        measured("imbalance", np.abs(imbalance).max(), 1e-6)
    settings, robot = free.settings, free.model.robot
    low, high = robot.joint_limits.T
    assert (low - 1e-6 <= result.joint_position).all()
    assert (result.joint_position <= high + 1e-6).all()
    assert result.margin >= settings.margin_min - 1e-6
    assert (np.abs(result.joint_torque) <= settings.torque_max).all()
    assert result.clearance >= settings.clearance_min - 1e-6
    roll, pitch, yaw = result.base_rpy
    assert settings.roll[0] - 1e-6 <= roll <= settings.roll[1] + 1e-6
    assert settings.pitch[0] - 1e-6 <= pitch <= settings.pitch[1] + 1e-6
    agree("yaw", yaw, settings.yaw, 1e-12)


def test_each_objective_is_best_at_its_own(free):
    thrifty, safe = (free.solve(SIDE_WIND, objective=objective) for objective in ("min_thrust", "max_margin"))
    assert thrifty.total_thrust < safe.total_thrust
    assert thrifty.margin < safe.margin


def test_flying_through_still_air_is_hovering_in_the_wind(held, flight):
    flying, hovering = held.solve((0.0, 0.0, 0.0), (8.0, 1.0, 0.0)), held.solve((-8.0, -1.0, 0.0))
    np.testing.assert_allclose(flying.thrust, hovering.thrust, atol=1e-8)
    np.testing.assert_allclose(flying.base_rpy, hovering.base_rpy, atol=1e-10)
    for imbalance in rust_imbalance(flight, flying, (0.0, 0.0, 0.0), (8.0, 1.0, 0.0)):
        measured("imbalance", np.abs(imbalance).max(), 1e-6)


def test_where_there_is_no_trim_the_violated_constraint_is_named(held, agree):
    result = held.solve((0.0, -20.0, 0.0))
    assert not result.feasible
    first = result.violations[0]
    assert (first.constraint, first.unit) == ("force balance along y", "N")
    assert 10.0 < first.missed_by < 30.0
    assert "roll at its upper limit" in result.at_limit
    assert "force balance along y missed by" in result.message
    # By as much as is left over there.
    agree("residual", abs(result.residual[1]), first.missed_by, 1e-3)


def test_the_closed_loop_stays_where_the_trim_put_it(free, flight):
    """A robot that starts in a trim, in its wind, has nothing to do."""
    result = free.solve(SIDE_WIND, objective="max_margin")
    initial = flight["simulator"]["initial"] | {
        "base_rpy_deg": np.degrees(result.base_rpy).tolist(),
        "joint_position": result.joint_position.tolist(),
        "thrust": result.thrust.tolist(),
        "free_fall_tick": False,
    }
    config = flight | {
        "simulator": flight["simulator"] | {"duration": 3.0, "initial": initial},
        "mission": {},
        "wind": {"profile": "constant", "velocity": list(SIDE_WIND)},
    }
    log = rust.fly(config).log
    assert np.abs(log["thrust"] - result.thrust).max() < 0.1
    measured("drift of the CoM [m]", np.abs(log["com_position"] - log["com_position"][0]).max(), 2e-3)
    measured("rotation error [rad]", log["rotation_error"].max(), 1e-3)


def test_a_start_nearby_leads_to_a_trim_as_good(free):
    first = free.solve(SIDE_WIND)
    again = free.solve(SIDE_WIND, start=first)
    assert again.feasible
    assert again.cost <= first.cost + 1e-8


@pytest.mark.close_to_tolerance("the expected thrusts are typed to the digits that the tolerance allows")
def test_without_an_arm_jet_the_others_hold_the_robot(free, flight, monkeypatch):
    """The weight is 425 N; the other arm is at its greatest thrust."""
    monkeypatch.setattr(free, "lost", 0)
    result = free.solve((0.0, 0.0, 0.0))
    assert result.feasible, result.message
    np.testing.assert_allclose(result.thrust, [0.0, 160.0, 180.1, 86.1], atol=0.1)
    imbalance, _ = rust_imbalance(flight, result, (0.0, 0.0, 0.0))
    assert abs(imbalance).max() < 1e-4  # N, N m; IPOPT's tolerance is 1e-8 of 100 N


LEVEL = TrimSettings(
    posture=np.zeros(0),
    free_joints=(),
    roll=(-0.1, 0.1),
    pitch=(-0.1, 0.1),
    yaw=0.0,
    margin_min=0.05,
    torque_max=np.zeros(0),
    clearance_min=-1.0,
    plume_length=1.0,
    posture_weight=1.0,
    spread_weight=1.0,
)
"""Of the platform, which has no joints."""


def test_a_robot_without_joints_and_links_has_a_trim(agree):
    """The platform: six thrusts and two angles for six equations, with a plate or with nothing near the exhausts."""
    platform = load_robot(ROOT / "configs/robot/platform.toml")
    for robot in (platform, replace(platform, aero_links=())):
        trim = Trim(MomentumModel(robot, {"model": "off"}), LEVEL)
        result = trim.solve((0.0, 0.0, 0.0))
        assert result.feasible, result.message
        assert np.isinf(result.clearance) == (not robot.aero_links)
        agree("thrust", result.thrust, np.full(6, 31.329), 1e-3)
        assert "greatest joint torque             0.00 N m" in experiment.report(trim, result)


def test_an_engine_that_runs_has_its_least_thrust(agree):
    """The platform hovers with 31.3 N in each of six engines, also if one has stopped and needs no least thrust."""
    platform = load_robot(ROOT / "configs/robot/platform.toml")
    top = float(platform.thrust_max[0])

    def trim_with(least):
        jets = (replace(platform.jets[0], thrust_min=least), *platform.jets[1:])
        return Trim(MomentumModel(replace(platform, jets=jets), {"model": "off"}), LEVEL)

    least = 31.5 - 0.05 * top
    trim = trim_with(least)
    result = trim.solve((0.0, 0.0, 0.0))
    assert result.feasible, result.message
    agree("thrust", result.thrust[0], 31.5, 1e-3)
    agree("margin", result.margin, (result.thrust[0] - least) / top, 1e-12)
    trim.lost = 0
    result = trim.solve((0.0, 0.0, 0.0))
    assert result.thrust[0] == 0.0
    assert all("thrust margin" not in violation.constraint for violation in result.violations)


def test_mk3_is_read_with_its_least_thrusts():
    robot = ROOT / "configs/robot/ironcub_mk3.toml"
    assert load_robot(robot).thrust_min.tolist() == rust.Robot(robot).thrust_min == 4 * [11.0]


def test_the_command_line(capsys):
    assert experiment.main(["hover_posture", "--without", "tail_jet"]) == 2
    for option in ("--wind", "--velocity"):
        for wrong in ("nan", "1e308"):
            assert experiment.main([option, wrong, "0", "0"]) == 2
    assert "tail_jet" in capsys.readouterr().err
    assert experiment.main(["hover_posture", "--wind", "0", "-10", "0"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("trim: Solve_Succeeded")
    assert "thrust of chest_r_jet" in said
    assert experiment.main(["hover_posture", "--wind", "0", "-20", "0"]) == 1
    assert capsys.readouterr().out.startswith("NO TRIM: force balance along y missed by")
    assert experiment.main(["vertical_posture"]) == 2
    assert "did you mean hover_posture?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--map", "--wind", "0", "0", "0"], "--wind is given beside --map"),
        (["--map", "--velocity", "1", "0", "0"], "--velocity is given beside --map"),
        (["--map", "--without", "tail_jet"], "--without is given beside --map"),
        (["--map", "--objective", "min_thrust"], "--objective is given beside --map"),
        (["--overwrite"], "--overwrite is given without --map"),
    ],
)
def test_an_option_without_effect_is_refused(words, named, capsys):
    assert experiment.main(["hover_posture", *words]) == 2
    assert capsys.readouterr().err == f"error: {named}, where it has no effect\n"


def shipped_text():
    """Return the shipped configuration of a posture, for a file elsewhere."""
    text = (ROOT / "experiments/studies/trim/hover_posture.toml").read_text()
    return text.replace("../../../jax_aero", str(ROOT / "jax_aero"))


def own_map(path, speeds, directions):
    """Write the shipped configuration with another map."""
    text = shipped_text()
    path.write_text(f"{text[: text.index('[map]')]}[map]\nspeeds = {speeds}\ndirections_deg = {directions}\n")
    return path


def test_a_map_is_a_result_with_a_manifest(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    path = own_map(tmp_path / "small.toml", speeds=[0.0, 10.0, 20.0], directions=[0.0, 90.0])
    document = experiment.STUDY.run(str(path))
    assert document["summary"]["trims requested"] == 12
    assert document["summary"]["strongest wind with a trim from every direction [m/s]"] == 10.0
    assert set(document["timings_s"]) == {"build", "all"}
    assert document["command"] == "jax-aero study trim '(outside the repository)/small.toml' --map"
    assert str(tmp_path) not in (tmp_path / "trim/small/manifest.json").read_text()

    data = xr.load_dataset(tmp_path / "trim/small/run.nc", engine="h5netcdf")
    assert data["feasible"].sel(objective="max_margin").values.tolist() == [[1, 1, 1], [1, 1, 0]]
    assert (
        str(data["violated"].sel(objective="max_margin", direction=90.0, speed=20.0).values) == "force balance along y"
    )
    _, hashes = FIGURES["trim"].draw_from_results(tmp_path, ("small", "small"))
    assert hashes == {"small": document["config_digest"]}
    assert np.isnan(data["margin"].sel(objective="max_margin", direction=90.0, speed=20.0))


def test_a_map_without_any_trim_is_written_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    path = own_map(tmp_path / "storm.toml", speeds=[20.0], directions=[90.0])
    assert experiment.main([str(path), "--map"]) == 1
    assert "NO TRIM in any of these winds" in capsys.readouterr().out
    summary = json.loads((tmp_path / "trim/storm/manifest.json").read_text())["summary"]
    assert (summary["trims requested"], summary["trims found"]) == (2, 0)
    assert summary["largest residual of a trim [N, N m]"] is None
    data = xr.load_dataset(tmp_path / "trim/storm/run.nc", engine="h5netcdf")
    assert not data["feasible"].any()


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("free_groups = []", 'free_groups = ["tail"]', "free_groups names `tail`"),
        ("directions_deg = [", "directions_deg = [0.0, ", r"`map.directions_deg` is \[0.0,0.0,.*each once"),
    ],
)
def test_a_configuration_that_cannot_be_meant_is_refused(tmp_path, old, new, complaint):
    text = shipped_text()
    assert old in text
    path = tmp_path / "odd.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(Refused, match=complaint):
        experiment.build(experiment.STUDY.read(str(path))[1])


@pytest.mark.parametrize(("speeds", "margin"), [([0.0, 5.0], 0.3), ([5.0], 0.3), ([0.0], 0.3), ([0.0, 5.0], np.nan)])
def test_a_map_of_trims_is_drawn_of_any_number_of_winds_and_trims(speeds, margin):
    """A map with one speed, or without a trim, is a result like any other."""
    grid, shape = ("objective", "direction", "speed"), (2, 2, len(speeds))
    variables = {name: (grid, np.full(shape, margin)) for name in ("margin", "total_thrust")} | {"weight": 430.0}
    coords = {"objective": ["max_margin", "min_thrust"], "direction": [0.0, 90.0], "speed": speeds}
    drawn = figure.draw(*[xr.Dataset(variables, coords)] * 2)
    drawn.canvas.draw()
