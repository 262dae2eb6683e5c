"""Tables of the free-stream simulations become datasets; bad ones are refused by file, line, column and value."""

import subprocess

import numpy as np
import pytest

from jax_aero.aero import dataset
from jax_aero.aero.posture import link_axes
from jax_aero.body.robot import load_robot
from jax_aero.data import cfd, import_cfd
from jax_aero.data.ironcub import JOINTS, LINKS, joint_position
from jax_aero.train import fit_aero
from tests.cfd_table import CFD_COLUMNS, in_tunnel_axes, modelled_rows, solver_table
from tests.measurements import measured


def table(changes=None, rows=None) -> str:
    """A solver's table of two postures in three winds, with a cell or the header changed."""
    rng = np.random.default_rng(1)
    rows = rows or [(c, p, y) for c in ("hovering", "Config2") for p, y in ((90, 0), (0, 40), (180, 140))]
    return solver_table([(*row, rng.normal(scale=0.01, size=(13, 3)).round(12)) for row in rows], changes)


def read(text):
    return cfd.read_solver_table(text, import_cfd.known_postures(), source="table.csv")


def test_a_row_comes_out_as_it_went_in_turned_into_base_axes():
    text = table()
    data = read(text)
    cells = dict(zip(CFD_COLUMNS, text.splitlines()[2].split(","), strict=True))
    for surface, link in cfd.SURFACES.items():
        drag, side, lift = (float(cells[f"{surface}-{kind}"]) for kind in ("cd", "cs", "cl"))
        np.testing.assert_allclose(in_tunnel_axes(data)[1, LINKS.index(link)], (drag, side, lift), atol=1e-14)
    # Prone, yaw 40 deg: p = -90 deg.
    np.testing.assert_allclose(data.wind_b[1], (0.0, -np.sin(np.radians(40)), -np.cos(np.radians(40))), atol=1e-12)
    upright = data.force_area_b[0, 0] - [
        float(text.splitlines()[1].split(",")[CFD_COLUMNS.index(f"head-{k}")]) for k in ("cd", "cs", "cl")
    ]
    np.testing.assert_allclose(upright, 0.0, atol=1e-14)


def test_poles_are_found_and_checks_are_kept():
    data = read(table())
    # Pitch 0, yaw 40 is pitch 180, yaw 140.
    assert data.checks["groups of equal posture and wind that occur more than once"] == 2
    measured("links minus whole robot [m2]", data.checks["links minus whole robot, largest [m2]"], 1e-9)
    assert data.checks["rows that should be their own mirror image"] == 1  # hovering, straight from ahead
    assert len(data.provenance["file_sha256"]) == 64


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table({(3, "head-cl"): "0.0x"}), r"column head-cl in line 3 of table.csv is 0.0x; expected a finite number"),
        (table({(4, "yawAngle"): ""}), r"column yawAngle in line 4 of table.csv is empty; expected a finite number"),
        (table({(4, "torso-cd"): "inf"}), r"column torso-cd in line 4 of table.csv is inf; expected a finite number"),
        (table({(5, "pitchAngle"): "190"}), r"line 5, column `pitchAngle`: 190; expected 0 to 180 degrees"),
        (table({(6, "config"): "Config99"}), r"line 6, column `config`: no joint angles are known for `Config99`"),
        (table({(2, "left-arm-cd"): "0.9"}), r"line 2: the surfaces differ by 0.\d+ m2 from `ironcub-\*`; expected"),
        (table({(1, "left-arm-cd"): "arm"}), r"column left-arm-cd of table.csv is absent; expected it once"),
        (",".join(CFD_COLUMNS) + "\n", r"has no rows; expected one per posture"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:1\n", r"Git LFS pointer"),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_by_line_column_and_value(text, message):
    with pytest.raises(ValueError, match=message):
        read(text)


def test_all_postures_without_angles_are_named_with_their_rows():
    text = table({(3, "config"): "one", (4, "config"): "two", (6, "config"): "one"})
    with pytest.raises(
        ValueError, match=r"line 3, column `config`: .* for `one` \(2 rows\), `two` \(1 row\); expected"
    ):
        read(text)


def test_a_short_line_is_refused():
    text = table().splitlines()
    text[3] = text[3].rsplit(",", 2)[0]
    with pytest.raises(ValueError, match="number of cells in line 4 of table"):
        read("\n".join(text))


def test_joint_angles_can_come_from_a_file(tmp_path, capsys):
    source, joints, out = tmp_path / "t.csv", tmp_path / "joints.csv", tmp_path / "out.nc"
    source.write_text(table(rows=[("mine", 90, 0)]))
    joints.write_text("name," + ",".join(f"{j}_deg" for j in JOINTS) + "\nmine," + ",".join(map(str, range(19))) + "\n")
    arguments = ["--table", str(source), "--out", str(out)]
    assert import_cfd.main(arguments) == 2
    assert "no joint angles are known for `mine`" in capsys.readouterr().err
    assert import_cfd.main([*arguments, "--joints", str(joints)]) == 0
    np.testing.assert_array_equal(dataset.load(out, load_robot(fit_aero.ROBOT)).joint_position_deg, [np.arange(19.0)])
    joints.write_text(joints.read_text().replace(",7,", ",seven,"))
    assert import_cfd.main([*arguments, "--joints", str(joints)]) == 2
    assert "column r_shoulder_pitch_deg in line 2 of " in capsys.readouterr().err


def test_a_clone_is_read_through_git(tmp_path, capsys, monkeypatch):
    clone, out = tmp_path / "clone", tmp_path / "out.nc"
    path = clone / import_cfd.TABLE_PATH
    path.parent.mkdir(parents=True)
    path.write_text(table())

    def git(*words):
        identity = ["-c", "user.name=t", "-c", "user.email=t@t", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", "-C", str(clone), *identity, *words], check=True, capture_output=True)

    git("init")
    git("add", ".")
    git("commit", "-m", "table")
    path.unlink()  # history is enough
    with monkeypatch.context() as without_git:
        without_git.setenv("PATH", "")
        assert import_cfd.main(["--clone", str(clone), "--out", str(out)]) == 2
    assert "git is not installed; give the table as a file" in capsys.readouterr().err
    assert import_cfd.main(["--clone", str(clone), "--commit", "HEAD", "--out", str(out)]) == 0
    assert dataset.load(out, load_robot(fit_aero.ROBOT)).sha256 == read(table()).sha256
    assert import_cfd.main(["--clone", str(clone), "--out", str(out)]) == 2
    assert "at commit 0d43057" in capsys.readouterr().err


def test_a_symmetric_robots_table_is_symmetric_and_written_twice_at_the_poles(tmp_path):
    """The axisymmetric model of a symmetric posture, in the frames of the tunnel: the import has to undo them."""
    robot = load_robot(fit_aero.ROBOT)
    posture = import_cfd.known_postures()["hovering"]
    axes = link_axes(robot, joint_position(robot, posture[None]))
    # Pitch 0 at yaw y and pitch 180 at yaw 180 - y are one wind; at yaw 90 deg every pitch is.
    winds = [(p, y) for p in (0, 30, 90, 150, 180) for y in (-170, -140, -90, -40, -10, 0, 10, 40, 90, 140, 170)]
    rows = modelled_rows({"hovering": axes[0]}, np.asarray(robot.aero_links.coefficients["corrected"]), winds)
    (tmp_path / "table.csv").write_text(solver_table(rows))
    assert import_cfd.main(["--table", str(tmp_path / "table.csv"), "--out", str(tmp_path / "f.nc")]) == 0
    data = dataset.load(tmp_path / "f.nc", robot)
    assert (len(data), data.postures) == (55, ("hovering",))
    # The table has 17 digits. Areas up to 0.06 m² are turned there and back; sums have 13 terms.
    measured("links minus whole robot [m2]", data.checks["links minus whole robot, largest [m2]"], 1e-15)
    twice = "groups of equal posture and wind that occur more than once"
    assert data.checks[twice] == 8 + 2
    # Turning areas up to 0.06 m² there and back rounds each by a few 1e-17.
    measured("within groups [m4]", data.checks["difference within those groups, mean square [m4]"], 1e-16**2)
    assert data.checks["rows that should be their own mirror image"] == 5
    square = (1.2e-7 * 0.06) ** 2  # axes of links come from joint angles in single precision
    measured("own mirror images [m4]", data.checks["their distance from it, mean square [m4]"], square)
    assert str(tmp_path) not in "".join(data.provenance.values())


def test_the_typed_postures_are_those_of_the_campaign():
    """Typed from the campaign's public list of joint configurations."""
    postures = import_cfd.known_postures()
    assert len(import_cfd.known_postures(sections=["free_stream"])) == 15
    assert {f"Config{number}" for number in (*range(1, 17), *range(107, 117), *range(118, 126))} <= set(postures)
    for name in ("hovering", "flight30", "flight50", "flight60"):
        np.testing.assert_array_equal(dataset.mirrored_joints(postures[name], JOINTS), postures[name])
    arms = {
        "flight30": [-40.7, 11.3, 26.5, 58.3, -40.7, 11.3, 26.5, 58.3],
        "Config2": [-37.5, 17.9, 40.0, 45.2, -37.5, 17.9, 40.0, 32.0],
        "Config114": [12.0, 23.3, 33.7, 50.5, -42.0, 36.8, 33.7, 42.6],
        "Config118": [-6.0, 36.8, 33.7, 39.1, -60.0, 23.3, 33.7, 33.9],
    }
    for name, angles in arms.items():
        np.testing.assert_array_equal(postures[name][3:11], angles)
