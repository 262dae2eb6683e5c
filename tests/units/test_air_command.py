"""`jax-aero air`: angles, tables, and sums that physics demands."""

import csv
import dataclasses

import numpy as np
import pytest

from jax_aero import air, cli, rust
from jax_aero.aero import aero_model
from jax_aero.aero.posture import total_wrench
from jax_aero.base import places
from jax_aero.body.robot import load_robot
from jax_aero.commands import air as command
from jax_aero.data.import_cfd import known_postures
from jax_aero.data.ironcub import joint_position
from tests.measurements import measured


def test_the_files_hold_every_link_and_their_sum(tmp_path, capsys):
    arguments = ["air", "--alpha", "30:90:30", "--wind", "8", "--beside", "cfd_tunnel", "--posture", "flight30"]
    assert cli.main([*arguments, "--out", str(tmp_path)]) == 0
    written = tmp_path / "iRonCub-Mk1--axisymmetric_corrected--flight30--alpha=30_90_30--beta=0--wind=8.csv"
    with written.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {path.suffix for path in tmp_path.iterdir()} == {".csv", ".png"}
    assert len(rows) == 3 * 14
    for alpha in ("30.0", "60.0", "90.0"):
        here = [row for row in rows if row["alpha_deg"] == alpha]
        for column in command.COLUMNS:
            total, parts = float(here[0][column]), [float(row[column]) for row in here[1:]]
            assert abs(total - sum(parts)) <= 2e-5 * max(map(abs, parts), default=1.0)  # six digits are written
        assert float(here[0]["drag_n"]) == pytest.approx(
            0.5 * air.AIR_DENSITY * 64.0 * float(here[0]["cda_m2"]), rel=1e-5
        )
    assert str(written.name) in capsys.readouterr().out


def test_areas_do_not_depend_on_the_density_of_a_models_air(tmp_path):
    thin = tmp_path / "thin.toml"
    thin.write_text('model = "axisymmetric"\ncoefficients = "corrected"\nair_density = 0.9\n')
    assert cli.main(["air", "--model", "axisymmetric_corrected", str(thin), "off", "--out", str(tmp_path)]) == 0
    (written,) = tmp_path.glob("*.csv")
    with written.open(encoding="utf-8") as file:
        dense, rare, off = (row for row in csv.DictReader(file) if row["link"] == command.ROBOT)
    assert float(rare["drag_n"]) == pytest.approx(0.9 / air.AIR_DENSITY * float(dense["drag_n"]), rel=1e-5)
    assert float(rare["cda_m2"]) == pytest.approx(float(dense["cda_m2"]), rel=1e-5)
    assert float(off["cda_m2"]) == 0.0


def test_the_loads_are_those_of_the_crate_turned_into_the_tunnel(x64):
    """Upright, the wind blows along base x and lift is up along base z; side forces follow the yaw."""
    robot = load_robot(places.find("robot", "ironcub_mk1"))
    model = aero_model(air.settings("axisymmetric_corrected"), robot)
    joints = command.posture(robot, "hovering")
    alphas, betas = np.array([90.0]), np.array([0.0, 25.0])
    found = command.loads(robot, model, joints, alphas, betas, 10.0)
    crate, table = rust.Robot(robot.source), rust.load_config("test2")["simulator"]["aero"]
    state = rust.State.at_rest(crate, joints)
    straight = rust.link_forces(crate, table, state, [10.0, 0.0, 0.0])
    measured("forces without yaw [N]", np.abs(found.forces[0] - straight).max(), 1e-10)
    yaw = np.radians(25.0)
    wind = 10.0 * np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    turned = rust.link_forces(crate, table, state, wind).sum(axis=0)
    total = found.forces[1].sum(axis=0)
    drag, side = turned @ wind / 10.0, turned @ np.array([np.sin(yaw), np.cos(yaw), 0.0])
    measured("forces with yaw [N]", np.abs(total - [drag, side, turned[2]]).max(), 1e-10)
    moment = total_wrench(
        robot, joint_position(robot, known_postures()["hovering"][None]), straight[None]
    ).moment_volume[0]
    measured("moment about the centre of mass [N m]", np.abs(found.moments[0].sum(axis=0) - moment).max(), 1e-10)


def test_a_robot_without_coefficients_and_named_postures_has_defaults(tmp_path, monkeypatch):
    made_up = np.zeros((2, 1, len(load_robot(places.find("robot", "sparrow")).aero_links.names), 3))
    monkeypatch.setattr(command, "loads", lambda *_: command.Loads(*made_up))
    monkeypatch.setattr(command, "aero_model", lambda *_: None)
    assert cli.main(["air", "--robot", "sparrow", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "sparrow--sphere_cylinder--zero--alpha=90--beta=0--wind=10.csv").is_file()


def test_angles_are_numbers_or_ranges():
    assert command.angles("--alpha", "90").tolist() == [90.0]
    assert command.angles("--alpha", "-10:10:5").tolist() == [-10.0, -5.0, 0.0, 5.0, 10.0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--alpha", "0:10"], "FROM:TO:STEP"),
        (["--alpha", "0:10:5", "--beta", "0:10:5"], "expected one range"),
        (["--alpha", "0:1e9:1e-3"], "--alpha is 0:1e9:1e-3; expected at most 10000 angles"),
        (["--beta", "0:1e308:1e-308"], "--beta is 0:1e308:1e-308; expected at most 10000 angles"),
        (["--posture", "hoverin"], "did you mean hovering"),
        (["--model", "axisymetric_corrected"], "did you mean axisymmetric_corrected"),
        (["--robot", "sparrow", "--posture", "hovering"], "expected --posture zero"),
        (["--robot", "sparrow", "--model", "axisymmetric_signed"], "coefficients is `signed`; sparrow has estimated"),
        (["--wind", "0"], "expected a number > 0, at most 1e+09"),
        (["--wind", "1e300"], "expected a number > 0, at most 1e+09"),
        (["--alpha", "0:20:10", "--beside", "wind_tunnel"], "holds nothing of posture"),
    ],
)
def test_mistakes_are_named(words, message, capsys):
    assert cli.main(["air", *words]) == cli.REFUSED
    assert message in capsys.readouterr().err


def test_the_axis_is_of_the_angle_that_varies():
    """A range may hold one angle."""
    given = command._parser().parse_args(["--alpha", "10:10:5", "--beta", "0:20:10", "--model", "network"])
    robot = load_robot(places.find("robot", "ironcub_mk1"))
    links = [command.ROBOT, *robot.aero_links.names]
    values = dict.fromkeys(command.COLUMNS, 1.0)
    rows = [
        {"model": given.model[0], "link": link, "alpha_deg": 10.0, "beta_deg": beta, **values}
        for link in links
        for beta in (0.0, 10.0, 20.0)
    ]
    axes = command._draw(rows, [], robot, given).axes[0]
    assert axes.get_xlabel() == "beta [deg]"
    assert axes.lines[0].get_xdata().tolist() == [0.0, 10.0, 20.0]


def test_a_robot_without_aerodynamic_links_has_no_legend_of_them():
    given = command._parser().parse_args(["--model", "sphere_cylinder", "--posture", "zero"])
    robot = load_robot(places.find("robot", "sparrow"))
    robot = dataclasses.replace(robot, aero_links=dataclasses.replace(robot.aero_links, names=()))
    row = {"model": "sphere_cylinder", "link": command.ROBOT, "alpha_deg": 90.0, "beta_deg": 0.0}
    figure = command._draw([row | dict.fromkeys(command.COLUMNS, 0.0)], [], robot, given)
    assert figure.axes[-1].get_legend() is None
