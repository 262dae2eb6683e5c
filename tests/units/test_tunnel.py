"""Balance files become force areas and moment volumes: rotations, arms and signs by files of made-up numbers."""

import numpy as np
import pytest
import xarray as xr

from jax_aero.aero.dataset import tunnel_from_base
from jax_aero.data import import_cfd, import_pressures, import_tunnel, tunnel
from jax_aero.data.import_cfd import known_postures
from tests.measurements import measured

HEADER = "CONF=STANDARD;FILETARA=TID_9999.tara;TID=1;DATA=2022/01/01   00:00:00; UM: A[m^2]"
COLUMNS = "ID(0),a_nom(1),b_nom(2),a(3),b(4),Br(5),ap(6),a_incl(7),V(8),Pdin(9),rho(10)"


def gvp(points, zero=(0.0,) * 6) -> str:
    """A balance file of points (number, pitch, yaw, speed, q, load of six), and a last reading without wind."""
    lines = [HEADER, COLUMNS]
    for number, pitch, yaw, speed, q, load in [*points, (0, 0.0, 0.0, 0.2, 0.02, zero)]:
        row = np.full(tunnel.GVP_COLUMNS, np.nan)
        row[[0, 1, 2, 3, 4, 8, 9, 10, 12]] = number, pitch, yaw, pitch, yaw, speed, q, 1.2, 293.0
        row[14:20], row[74:80] = load, 0.1
        lines.append("\t".join(f"{value:.6E}" for value in row))
    return "\n".join(lines) + "\n"


def clone(tmp_path, files, campaign="wind-tunnel/exp_2022_11_03"):
    folder = tmp_path / campaign / "data_GVPM"
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return tmp_path


def read(tmp_path, name, text, side="below", campaign="wind-tunnel/exp_2022_11_03"):
    (points,) = import_tunnel.from_clone(clone(tmp_path, {name: text}, campaign))
    return import_tunnel.reduce_moments(points, side)


def test_drag_from_ahead_is_backward_and_its_arm_is_the_balance_offset(tmp_path):
    # 20 N backward: -X of the balance, q 80 Pa: 0.25 m2 along x of the base; no moment at the balance centre.
    data = read(tmp_path, "TID_0001.GVP", gvp([(1, 0.0, 0.0, 12.0, 80.0, (-20.0, 0, 0, 0, 0, 0))]))
    np.testing.assert_allclose(data["force_area"].values, [[0.25, 0.0, 0.0]], atol=1e-12)
    # The centre lies 21 mm below the hip: a force backward there turns the hip about -y, z x F = -0.021 * 0.25.
    np.testing.assert_allclose(data["moment_hip"].values, [[0.0, -0.021 * 0.25, 0.0]], atol=1e-12)
    above = read(tmp_path / "above", "TID_0001.GVP", gvp([(1, 0.0, 0.0, 12.0, 80.0, (-20.0, 0, 0, 0, 0, 0))]), "above")
    np.testing.assert_allclose(above["moment_hip"].values, [[0.0, 0.021 * 0.25, 0.0]], atol=1e-12)
    com = data["com"].values[0]
    expected = data["moment_hip"].values[0] + np.cross(tunnel.HIP - com, [0.25, 0.0, 0.0])
    np.testing.assert_allclose(data["moment_com"].values[0], expected, atol=1e-12)


def test_every_component_of_a_moment_is_turned_into_base_axes(tmp_path):
    data = read(tmp_path, "TID_0001.GVP", gvp([(1, 0.0, 0.0, 12.0, 100.0, (0, 0, 0, 1.0, 2.0, 3.0))]))
    np.testing.assert_allclose(data["moment_balance"].values, [[-0.01, -0.02, 0.03]], atol=1e-12)
    np.testing.assert_allclose(data["moment_com"].values, data["moment_balance"].values, atol=1e-15)


@pytest.mark.parametrize(("pitch", "yaw"), [(0.0, 0.0), (-20.0, 0.0), (20.0, 30.0)])
def test_a_flight_posture_is_mounted_at_45_degrees(tmp_path, pitch, yaw):
    # The balance turns with the robot, so drag alone is drag alone after both turns: Ry of the balance's own pitch
    # and yaw, then the mount.
    drag = np.array([1.0, 0.0, 0.0])
    base = tunnel_from_base(45.0 + pitch, yaw).T @ drag
    load = tunnel.base_from_balance("mk1", "flight").T @ base * 50.0
    row = (1, pitch, yaw, 17.0, 50.0, (*load, 0, 0, 0))
    data = read(tmp_path, "TID_0017.GVP", gvp([row]))
    assert data["pitch"].item() == pytest.approx(45.0 + pitch)
    off = np.abs(data["force_area"].values[0] - base).max()
    measured("force area [m2]", off, 1e-6, because="six decimals of the load in the file, over 50 Pa")
    if yaw == 0.0:
        # Upright on the balance at zero, the load is along -X and +Z only by the balance's own pitch.
        turned = np.array([-np.cos(np.radians(pitch)), 0.0, np.sin(np.radians(pitch))])
        np.testing.assert_allclose(load / 50.0, turned, atol=1e-12)


def test_mk3_has_other_balance_axes_and_a_balance_behind_its_centre_of_mass(tmp_path):
    row = (1, 90.0, 10.0, 12.0, 50.0, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    data = read(tmp_path, "TID_0001.GVP", gvp([row]), campaign="wind-tunnel/exp_2023_12_11")
    np.testing.assert_allclose(data["force_area"].values, [[0.06, -0.02, -0.04]], atol=1e-12)
    np.testing.assert_allclose(data["moment_balance"].values, [[0.12, -0.08, -0.1]], atol=1e-12)
    assert np.isnan(data["moment_hip"]).all()
    # Its balance is 21 cm behind and 3 cm below the centre of mass; x of the table is backward.
    arm = np.array([0.206, 0.0, -0.024]) - data["com"].values[0]
    np.testing.assert_allclose(arm, [0.2017, 0.0, -0.0321], atol=2e-3)
    turned = np.array([0.12, -0.08, -0.1]) + np.cross(arm, [0.06, -0.02, -0.04])
    np.testing.assert_allclose(data["moment_com"].values, [turned], atol=1e-12)
    assert (data["pitch"].item(), data["yaw"].item()) == (90.0, -10.0)  # its yaw turns the other way


def test_the_budget_has_lever_zero_return_and_repeatability(tmp_path):
    zero = (0.8, 0.0, 0.0, 0.0, 0.4, 0.0)
    data = read(tmp_path, "TID_0001.GVP", gvp([(1, 0.0, 0.0, 12.0, 80.0, (-20.0, 0, 0, 0, 0, 0))], zero))
    # A force along x: deviations of the offset's height 5 mm and side 10 mm turn it about y and z.
    np.testing.assert_allclose(data["u_lever"].values, [[0.0, 0.25 * 0.005, 0.25 * 0.01]], atol=1e-12)
    com = data["com"].values[0]
    arm = np.array([0.497, 0.0, -0.021]) + tunnel.HIP - com
    expected = np.abs(np.array([0.0, -0.005, 0.0]) + np.cross(arm, [-0.01, 0.0, 0.0]))
    np.testing.assert_allclose(data["u_zero"].values[0], expected, atol=1e-12)
    parts = [data[name].values for name in ("u_lever", "u_zero", "u_repeat")]
    np.testing.assert_allclose(data["u_total"].values, np.linalg.norm(parts, axis=0), atol=1e-15)


def test_points_in_which_the_support_shows_are_marked(tmp_path):
    rows = [(n, 0.0, yaw, 12.0, 80.0, (0.0,) * 6) for n, yaw in ((1, 0.0), (2, 20.0), (3, -25.0))]
    data = read(tmp_path, "TID_0001.GVP", gvp(rows))
    assert data["robot_only"].values.tolist() == [1, 1, 0]
    assert data["marks"].values.tolist() == ["", "", "support"]
    # The seventh point, whatever number it has in the file.
    rows = [(n, pitch, 0.0, 17.0, 160.0, (0.0,) * 6) for n, pitch in enumerate((0.0,) * 6 + (10.0,), start=11)]
    doubtful = read(tmp_path / "tare", "TID_0057.GVP", gvp(rows))
    assert doubtful["marks"].values.tolist() == [*["tare drifted"] * 6, "tare drifted, outlier, tare extrapolated"]
    assert doubtful["number"].values.tolist() == [1, 2, 3, 4, 5, 6, 7]


def test_a_gravity_sweep_gives_the_centre_of_gravity(tmp_path):
    place, weight = np.array([0.46, -0.01, 0.05]), 430.0
    lines = ["a_nom[deg], b_nom[deg], Br[deg], ap[deg], FxyzMxyz bil1 [N-Nm], CONF=STANDARD;"]
    for pitch in (-20.0, -10.0, 10.0, 20.0):
        angle = np.radians(pitch)
        force = weight * np.array([-np.sin(angle), 0.0, 1.0 - np.cos(angle)])
        numbers = (pitch, 0.0, 0.0, pitch, *force, *np.cross(place, force))
        lines.append("\t".join(f"{value:.9f}" for value in numbers))
    sweeps = import_tunnel.gravity_sweeps(clone(tmp_path, {"TID_1001.tara": "\n".join(lines)}))
    found, deviation = sweeps["exp_2022_11_03"]["TID_1001"]
    # Nine decimals of the file over 140 N and, for x and y, over the 26 N that the weight's height changes by.
    measured("centre of gravity [m]", np.abs(found - place).max(), 1e-9, because="nine decimals over 26 N")
    assert deviation.max() < 1e-9


POINT, SWEEP = gvp([(1, 0.0, 0.0, 12.0, 80.0, (0.0,) * 6)]), "a_nom[deg]\n"


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (tunnel.read_gvp, "nothing", "no balance file"),
        (tunnel.read_gvp, POINT.replace("NAN\n", "NAN\t0\n"), "expected 86"),
        (tunnel.read_gvp, POINT.replace("8.000000E+01", "8,0"), "column `9`: '8,0'"),
        (tunnel.read_gvp, gvp([(1, 0.0, 0.0, 12.0, 80.0, (np.nan,) * 6)]), "column `14`: 'NAN'"),
        (tunnel.read_sweep, SWEEP, "a.txt: no gravity sweep; expected .* rows"),
        (
            tunnel.read_sweep,
            SWEEP + "\t".join("1" * 10) + "\n\n1\t2\n",
            "a.txt, line 4: 2 columns; expected at least 10",
        ),
        (
            tunnel.read_sweep,
            SWEEP + "\t".join("1" * 9) + "\tnan\n",
            "a.txt, line 2, column `9`: 'nan'; expected a finite number",
        ),
    ],
)
def test_a_file_that_is_none_or_incomplete_is_refused_with_its_place(read, text, message):
    with pytest.raises(ValueError, match=message):
        read(text, "a.txt")


def test_names_of_tests_may_be_in_lower_case(tmp_path):
    lines = gvp([(1, 0.0, 0.0, 12.0, 80.0, (0.0,) * 6)])
    (points,) = import_tunnel.from_clone(clone(tmp_path, {"tid_0001.gvp": lines, "TID_0018.GVP": lines}))
    assert set(points.test) == {"TID_0001", "TID_0018"}


def test_the_command_writes_what_it_reads(tmp_path, capsys):
    row = (1, 0.08, -0.01, 12.0, 85.0, (-20.0, -0.5, 0.4, -0.4, -1.6, -0.1))
    files = clone(tmp_path / "clone", {"TID_0001.GVP": gvp([row])})
    assert import_tunnel.main(["--clone", str(files), "--out", str(tmp_path / "a")]) == 0
    assert "mk1: 1 points of 1 tests" in capsys.readouterr().out
    (points,) = import_tunnel.from_clone(files)
    written = xr.load_dataset(tmp_path / "a" / "tunnel_mk1.nc", engine="h5netcdf")
    xr.testing.assert_allclose(written, import_tunnel.reduce_moments(points), atol=1e-12)
    assert import_tunnel.main(["--clone", str(tmp_path / "nowhere")]) == 2
    assert "expected a clone" in capsys.readouterr().err


@pytest.mark.parametrize(("robot", "table"), [("mk1", import_cfd.POSTURES), ("mk3", import_tunnel.POSTURES_OF_MK3)])
def test_all_postures_of_the_tests_are_known(robot, table):
    tests = import_tunnel.known_tests()
    named = {about.posture for about in tests.values() if about.robot == robot}
    assert named
    assert named <= set(known_postures(path=table))
    assert len(tests) == 157


# --- surface pressures


def pressures(tmp_path, campaign, values, ports=((101, "I1"), (102, "J5"), (103, "J6"), (104, "Ndef131"), (105, "E2"))):
    """A clone with one test of a point at 80 Pa and its zero, whose ports read `values`, and without wind 1 Pa each."""
    texts = {
        f"TID_0003_PT{row:04}.prm": "\n".join(f"{port}.00000000\t{value:.8f}" for (port, _), value in rows)
        for row, rows in enumerate((zip(ports, values, strict=True), ((port, 1.0) for port in ports)), start=1)
    }
    scanner = "\n".join(["Scanner ID;Sensor ID", *(f"{port};{tap}" for port, tap in ports), ""])
    files = {"TID_0003.GVP": gvp([(1, 0.0, 10.0, 12.0, 80.0, (0.0,) * 6)]), "Pressure_Sensors_Map.csv": scanner}
    folder = clone(tmp_path / campaign, files | texts, f"wind-tunnel/{campaign}")
    ((robot, data),) = import_pressures.from_clone(folder)
    return robot, data


def test_pressures_become_coefficients_of_their_taps(tmp_path):
    """J5 and J6, exchanged in November alone, are mended and stated; what is doubtful is flagged, and kept as it is."""
    values = (80.0, -40.0, 20.0, 5.0, 8.0)
    cp = {"I1": 1.0, "J5": 0.25, "J6": -0.5, "E2": 0.1}
    for campaign, exchanged, doubtful in (("exp_2022_11_03", True, []), ("exp_2022_03_21", False, ["E2"])):
        robot, data = pressures(tmp_path, campaign, values)
        expected = cp if exchanged else cp | {"J5": -0.5, "J6": 0.25}
        assert (robot, sorted(data["tap"].values)) == ("mk1", sorted(cp))  # a port without a tap is none
        assert {tap: float(data["cp"].sel(tap=tap)[0]) for tap in cp} == expected
        assert (data["zero"].values == 1.0).all()
        assert [tap for tap in data["tap"].values if data["flag"].sel(tap=tap).item()] == doubtful
        assert ("J5 and J6" in import_pressures.summary(data)) == exchanged
        assert (float(data["yaw"][0]), data.sizes["point"]) == (10.0, 1)


def test_pressures_of_other_ports_are_refused(tmp_path):
    with pytest.raises(ValueError, match="expected a header with `Scanner ID`"):
        import_pressures.read_map("101;I1\n", "map.csv")
    folder = clone(tmp_path, {"TID_0003.GVP": gvp([(1, 0.0, 0.0, 12.0, 80.0, (0.0,) * 6)])})
    with pytest.raises(import_pressures.Refused, match="has no pressures"):
        list(import_pressures.from_clone(folder))
    data = folder / "wind-tunnel/exp_2022_11_03/data_GVPM"
    (data / "Pressure_Sensors_Map.csv").write_text("Scanner ID;Sensor ID\n101;I1\n102;I2\n")
    (data / "TID_0003_PT0001.prm").write_text("101.0\t1.0\n")
    with pytest.raises(ValueError, match="no port 102"):
        list(import_pressures.from_clone(folder))
