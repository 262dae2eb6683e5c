"""A URDF becomes a robot that is described, checked, trimmed and flown by one command."""

import struct
import tomllib
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from experiments import Refused
from experiments.import_robot import command, skeleton
from jax_aero import mesh

ROBOTS = Path(__file__).resolve().parents[2] / "configs" / "robot"


def binary_stl(corners):
    """One triangle for every three corners in turn."""
    triangles = [corners[i : i + 3] for i in range(len(corners) - 2)]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles)
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + body


def ascii_stl(corners):
    """The same as text."""
    facets = ["facet normal 0 0 0\nouter loop"]
    facets += ["vertex " + " ".join(str(x) for x in corner) for corner in corners]
    return "\n".join(["solid box", *facets, "endloop\nendfacet", "endsolid box"]).encode()


CORNERS = [tuple(map(float, corner)) for corner in product((-350, 350), (-300, 300), (-30, 30))]


@pytest.mark.close_to_tolerance("the file names lengths in tenths of a millimetre")
@pytest.mark.parametrize("stl", [binary_stl, ascii_stl])
def test_meshes_named_by_package_give_the_sizes_of_links(tmp_path, stl, agree, measured):
    """The platform with a mesh in mm in place of its cylinder: it loads, trims and hovers."""
    folder = tmp_path / "share" / "plates"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "plate.stl").write_bytes(stl(CORNERS))
    text = (ROBOTS / "platform.urdf").read_text()
    mesh = '<mesh filename="package://plates/meshes/plate.stl" scale="0.001 0.001 0.001"/>'
    (folder / "plate.urdf").write_text(text.replace('<cylinder radius="0.35" length="0.06"/>', mesh))
    jets = [command.thruster(f"nozzle_{k}:z:80") for k in range(6)]
    result = command.import_robot(folder / "plate.urdf", tmp_path / "out", jets=jets)
    link = tomllib.loads((tmp_path / "out" / "robot.toml").read_text())["aero_links"][0]
    agree("length", link["length"], 0.06, 1e-12)  # a plate's axis is its short edge
    measured("diameter", abs(link["diameter"] - np.sqrt(0.7 * 0.6)), 1e-4)
    assert np.abs(result.trim.residual).max() < 1e-6
    assert result.hover.outcome == "completed"
    for name in ("robot", "controller", "hover"):
        path = tmp_path / "out" / f"{name}.toml"
        first = path.read_text(encoding="utf-8").splitlines()[0]
        assert (path.parent / first.removeprefix("#:schema ")).is_file()
    assert result.hover.summary["max_com_error"] < 0.01


def test_the_sparrows_urdf_becomes_a_robot_that_flies(tmp_path, capsys):
    jets = ["back_nozzle:z:100", "l_thruster:-x:100", "r_thruster:-x:100"]
    words = [str(ROBOTS / "sparrow.urdf"), "--out", str(tmp_path / "sparrow"), "--hold", "neck"]
    words += [word for jet in jets for word in ("--jet", jet)] + ["--foot", "l_sole", "--foot", "r_sole"]
    assert command.main(words) == 0
    printed = capsys.readouterr().out
    assert "Solve_Succeeded" in printed
    assert "completed" in printed
    table = tomllib.loads((tmp_path / "sparrow" / "robot.toml").read_text())
    names = [joint["name"] for group in table["joint_groups"] for joint in group["joints"]]
    assert sorted(names) == ["l_hip", "l_shoulder", "r_hip", "r_shoulder", "waist"]
    assert names.index("waist") < names.index("l_shoulder")
    assert [foot["name"] for foot in table["feet"]] == ["l_sole", "r_sole"]
    # The files are the user's: nothing is written over them.
    assert command.main(words) == 2
    assert "not empty" in capsys.readouterr().err


def test_what_is_not_there_is_refused_by_name(tmp_path):
    urdf, folder = ROBOTS / "sparrow.urdf", tmp_path / "out"
    with pytest.raises(Refused, match="`tail` is no link"):
        command.import_robot(urdf, folder, jets=[skeleton.Thruster("tail", "z", 100.0)])
    with pytest.raises(Refused, match="`nack` is no joint"):
        command.import_robot(urdf, folder, jets=[], held=["nack"])
    with pytest.raises(Refused, match=r"package://nowhere/a.stl: 0 files"):
        mesh.mesh_file("package://nowhere/a.stl", tmp_path)
    assert not folder.exists()
