"""Tables of the free-stream simulations become datasets; bad ones are refused by file, line, column and value."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from experiments import import_cfd
from jax_aero.aero import cfd_import, dataset
from jax_aero.aero.dataset import JOINTS, LINKS
from tests.measurements import measured

ROOT = Path(__file__).resolve().parents[2]
PUBLIC_TABLE = ROOT.parent / "shared" / "data" / "cfd_freestream.csv"
COLUMNS = [
    "config",
    "pitchAngle",
    "yawAngle",
    *(f"{part}-{kind}" for part in ["ironcub", *cfd_import.SURFACES] for kind in ("cd", "cl", "cs")),
]


def table(changes=None, rows=None) -> str:
    """A solver's table of two postures in three winds, with a cell or the header changed."""
    rng = np.random.default_rng(1)
    lines = [list(COLUMNS)]
    for config, pitch, yaw in rows or [
        (c, p, y) for c in ("hovering", "Config2") for p, y in ((90, 0), (0, 40), (180, 140))
    ]:
        links = rng.normal(scale=0.01, size=(13, 3))
        lines.append(
            [config, str(pitch), str(yaw), *(f"{value:.12g}" for value in [*links.sum(axis=0), *links.ravel()])]
        )
    for (line, column), value in (changes or {}).items():
        lines[line - 1][COLUMNS.index(column)] = value
    return "\n".join(",".join(line) for line in lines) + "\n"


def read(text):
    return cfd_import.read_solver_table(text, import_cfd.known_postures(), source="table.csv")


def test_a_row_comes_out_as_it_went_in_turned_into_base_axes():
    text = table()
    data = read(text)
    cells = dict(zip(COLUMNS, text.splitlines()[2].split(","), strict=True))
    for surface, link in cfd_import.SURFACES.items():
        drag, side, lift = (float(cells[f"{surface}-{kind}"]) for kind in ("cd", "cs", "cl"))
        np.testing.assert_allclose(data.force_area_w[1, LINKS.index(link)], (drag, side, lift), atol=1e-14)
    # Prone, yaw 40 deg: p = -90 deg.
    np.testing.assert_allclose(data.wind_b[1], (0.0, -np.sin(np.radians(40)), -np.cos(np.radians(40))), atol=1e-12)
    upright = data.force_area_b[0, 0] - [
        float(text.splitlines()[1].split(",")[COLUMNS.index(f"head-{k}")]) for k in ("cd", "cs", "cl")
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
        (table({(3, "head-cl"): "0.0x"}), r"table.csv, line 3, column `head-cl`: '0.0x'; expected a finite number"),
        (table({(4, "yawAngle"): ""}), r"line 4, column `yawAngle`: ''; expected a finite number"),
        (table({(4, "torso-cd"): "inf"}), r"line 4, column `torso-cd`: 'inf'; expected a finite number"),
        (table({(5, "pitchAngle"): "190"}), r"line 5, column `pitchAngle`: 190; expected 0 to 180 degrees"),
        (table({(6, "config"): "Config99"}), r"line 6, column `config`: no joint angles are known for `Config99`"),
        (table({(2, "left-arm-cd"): "0.9"}), r"line 2: the surfaces differ by 0.\d+ m2 from `ironcub-\*`; expected"),
        (table({(1, "left-arm-cd"): "arm"}), r"line 1: column `left-arm-cd` missing; expected config"),
        (",".join(COLUMNS) + "\n", r"has no rows; expected one per posture"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:1\n", r"Git LFS pointer"),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_by_line_column_and_value(text, message):
    with pytest.raises(ValueError, match=message):
        read(text)


def test_a_short_line_is_refused():
    text = table().splitlines()
    text[3] = text[3].rsplit(",", 2)[0]
    with pytest.raises(ValueError, match="line 4, column `right-leg-lower-cs`: the line ends before it; expected"):
        read("\n".join(text))


def test_joint_angles_can_come_from_a_file(tmp_path, capsys):
    source, joints, out = tmp_path / "t.csv", tmp_path / "joints.csv", tmp_path / "out.nc"
    source.write_text(table(rows=[("mine", 90, 0)]))
    joints.write_text("name," + ",".join(f"{j}_deg" for j in JOINTS) + "\nmine," + ",".join(map(str, range(19))) + "\n")
    arguments = ["--table", str(source), "--out", str(out)]
    assert import_cfd.main(arguments) == 2
    assert "no joint angles are known for `mine`" in capsys.readouterr().err
    assert import_cfd.main([*arguments, "--joints", str(joints)]) == 0
    np.testing.assert_array_equal(dataset.load(out).joint_position_deg, [np.arange(19.0)])
    joints.write_text(joints.read_text().replace(",7,", ",seven,"))
    assert import_cfd.main([*arguments, "--joints", str(joints)]) == 2
    assert "line 2, column `r_shoulder_pitch_deg`: 'seven'; expected a finite number" in capsys.readouterr().err


def test_a_clone_is_read_through_git(tmp_path, capsys):
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
    assert import_cfd.main(["--clone", str(clone), "--commit", "HEAD", "--out", str(out)]) == 0
    assert dataset.load(out).sha256 == read(table()).sha256
    assert import_cfd.main(["--clone", str(clone), "--out", str(out)]) == 2
    assert "at commit 0d43057" in capsys.readouterr().err


def mat(path, **changes):
    rng = np.random.default_rng(2)
    pitch, yaw = np.array([[90.0], [0.0], [30.0]]), np.array([[0.0], [40.0], [-20.0]])
    variables = {
        "pitchAngles_full": pitch,
        "yawAngles_full": yaw,
        "windDirection_full": dataset.wind_direction(pitch[:, 0], yaw[:, 0]),
        "jointPosDeg_full": np.stack([np.arange(19.0), np.arange(19.0), -np.arange(19.0)]),
        **{f"link{kind}As_matrix": rng.normal(scale=0.01, size=(3, 13)) for kind in ("Cd", "Cl", "Cs")},
    }
    savemat(path, {name: value for name, value in (variables | changes).items() if value is not None})
    return variables


@pytest.mark.parametrize("frame", ["base", "wind"])
def test_the_training_file_is_read_in_either_frame(tmp_path, frame):
    written = mat(tmp_path / "data.mat")
    data = cfd_import.read_mat(tmp_path / "data.mat", frame=frame)
    areas = data.force_area_b if frame == "base" else data.force_area_w
    expected = np.stack([written[f"link{kind}As_matrix"] for kind in ("Cd", "Cs", "Cl")], axis=2)
    np.testing.assert_allclose(areas, expected, atol=1e-15)
    assert data.posture[0] == data.posture[1] != data.posture[2]
    np.testing.assert_array_equal(data.joint_position_deg, written["jointPosDeg_full"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"linkClAs_matrix": None}, "variable `linkClAs_matrix` is missing"),
        ({"linkCsAs_matrix": np.zeros((3, 12))}, r"`linkCsAs_matrix` has shape \(3, 12\); expected \(3, 13\)"),
        ({"linkCdAs_matrix": np.where(np.arange(39).reshape(3, 13) == 14, np.nan, 0.0)}, "row 2, column 2 is no"),
        ({"windDirection_full": -np.eye(3)}, "`windDirection_full` row 1 is .* expected .*pitch 90 and yaw 0"),
    ],
)  # fmt: skip
def test_a_bad_training_file_is_refused(tmp_path, changes, message):
    mat(tmp_path / "data.mat", **changes)
    with pytest.raises(ValueError, match=message):
        cfd_import.read_mat(tmp_path / "data.mat")


def test_what_is_no_training_file_is_refused(tmp_path):
    (tmp_path / "data.mat").write_text("text")
    with pytest.raises(ValueError, match="not a MATLAB file"):
        cfd_import.read_mat(tmp_path / "data.mat")


@pytest.mark.skipif(not PUBLIC_TABLE.is_file(), reason="the public free-stream table is not here")
def test_the_public_table_imports_and_keeps_its_known_properties(tmp_path, capsys):
    assert import_cfd.main(["--table", str(PUBLIC_TABLE), "--out", str(tmp_path / "f.nc")]) == 0
    data = dataset.load(tmp_path / "f.nc")
    assert (len(data), len(data.postures)) == (4826, 15)
    measured("links minus whole robot [m2]", data.checks["links minus whole robot, largest [m2]"], 1e-8)
    assert data.checks["groups of equal posture and wind that occur more than once"] == 254
    # The poles were simulated once and written twice: our frames bring the two to the same base axes.
    measured("difference within groups [m4]", data.checks["difference within those groups, mean square [m4]"], 1e-8)
    # Half of this, 1.9e-6, is what one run violates symmetry by.
    assert data.checks["their distance from it, mean square [m4]"] == pytest.approx(3.8e-6, rel=0.01)
    assert data.checks["variance over the 39 components [m4]"] == pytest.approx(1.30e-4, rel=0.005)
    assert str(tmp_path) not in "".join(data.provenance.values())


def test_the_typed_postures_are_those_of_the_campaign():
    postures = import_cfd.known_postures()
    assert len(import_cfd.known_postures(sections=["free_stream"])) == 15
    for name in ("hovering", "flight30", "flight50", "flight60"):
        np.testing.assert_array_equal(dataset.mirrored_joints(postures[name]), postures[name])
    source = ROOT.parent / "shared" / "data" / "joint_configs.csv"
    if source.is_file():
        published = dataset.read_postures(source)
        typed = {name: angles for name, angles in postures.items() if name in published}
        assert len(typed) == 31
        for name, angles in typed.items():
            np.testing.assert_array_equal(angles, published[name])
