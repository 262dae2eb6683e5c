"""A robot of meshes can be looked at; foreign sites are turned away."""

import http.client
import io
import itertools
import os
import re
import socket
import threading
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.base import places
from jax_aero.body import mesh
from jax_aero.body.mesh import read_mesh
from jax_aero.view import Refused, web
from jax_aero.view.shapes import Look, look_of

SPARROW = places.find("robot", "sparrow")


def draw_meshes(folder: Path, filenames: list[str]) -> Look:
    """Return the look of the sparrow with a mesh in place of every primitive, from these files in turn."""
    others = itertools.cycle(f'<mesh filename="{name}" scale="0.1 0.1 0.2"/>' for name in filenames)
    robot = rust.Robot(SPARROW)
    text = re.sub(r"<geometry>.*?</geometry>", lambda _: f"<geometry>{next(others)}</geometry>", robot.urdf_text)
    path = folder / "sparrow.toml"
    path.write_text(robot.toml_text, encoding="utf-8")
    path.with_suffix(".urdf").write_text(text, encoding="utf-8")
    return look_of(rust.Robot(path), path)


def test_links_whose_mesh_is_missing_are_drawn_as_the_air_sees_them(tmp_path):
    shown = look_of(rust.Robot(SPARROW), SPARROW)
    assert shown.missing == ()
    look = draw_meshes(tmp_path, ["package://bird/body.stl"])
    missing = {reason.split(":")[0] for reason in look.missing}
    assert missing == {shape.name for shape in shown.shapes if shape.role != "strut"}
    assert all("package://bird/body.stl: 0 files" in reason for reason in look.missing)
    drawn = {shape.name: shape for shape in look.shapes if shape.role != "strut"}
    table = tomllib.loads(rust.Robot(SPARROW).toml_text)
    assert set(drawn) == {entry["frame"] for entry in table["aero_links"]} & missing
    entry = next(
        entry for entry in table["aero_links"] if not entry.get("is_sphere", False) and entry["frame"] in drawn
    )
    shape = drawn[entry["frame"]]
    assert shape.size == (0.5 * entry["diameter"], 0.5 * entry["diameter"], entry["length"])


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES)
STL = "solid t\n{}endsolid t\n".format(
    "".join(
        "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n".format(
            "".join(f"vertex {x} {y} {z}\n" for x, y, z in CORNERS[face])
        )
        for face in FACES
    )
)
DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2000-01-01T00:00:00</created><modified>2000-01-01T00:00:00</modified><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="12">{corners}</float_array><technique_common>
<accessor source="#a" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
""".format(corners=" ".join(map(str, CORNERS.ravel())), faces=" ".join(map(str, FACES.ravel())))


def test_meshes_of_three_formats_are_drawn(tmp_path, monkeypatch):
    pytest.importorskip("trimesh", reason="trimesh is not installed: make setup")
    pytest.importorskip("collada", reason="collada is not installed: make setup")
    package = tmp_path / "packages" / "bird"
    package.mkdir(parents=True)
    texts = {"a.stl": STL, "b.obj": OBJ, "c.dae": DAE}
    for name, text in texts.items():
        (package / name).write_text(text, encoding="utf-8")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    look = draw_meshes(tmp_path, [f"package://bird/{name}" for name in texts])
    assert look.missing == ()
    shapes = [shape for shape in look.shapes if shape.role != "strut"]
    assert {shape.kind for shape in shapes} == {"mesh"}
    assert len(shapes) > len(texts)
    for shape in shapes:
        assert shape.mesh is not None
        assert shape.size == (0.1, 0.1, 0.2)
        corners = shape.mesh.vertices[shape.mesh.faces]
        # Volume of the tetrahedron, and faces outwards.
        volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        assert abs(volume - 1.0 / 6.0) < 1e-7  # single precision of a file's numbers


def in_a_zip(text):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("a.dae", text)
    return content.getvalue()


def repeating(levels):
    """Nodes that repeat one another: of the tetrahedron, 4 to this power."""
    nodes = '<node id="n0"><instance_geometry url="#g"/></node>'
    for level in range(levels):
        nodes += f'<node id="n{level + 1}">' + 4 * f'<instance_node url="#n{level}"/>' + "</node>"
    text = DAE.replace("<library_visual_scenes>", f"<library_nodes>{nodes}</library_nodes><library_visual_scenes>")
    return text.replace(
        '<instance_geometry url="#g"/></node></visual', f'<instance_node url="#n{levels}"/></node></visual'
    )


def of_entities(text):
    return text.replace("<COLLADA", '<!DOCTYPE a [<!ENTITY b "1">]><COLLADA', 1).replace("2000-01", "&b;000-01", 1)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.zip", in_a_zip(DAE), "expected one of .stl, .obj, .dae"),
        ("a.gltf", b"{}", "expected one of .stl, .obj, .dae"),
        ("a.dae", in_a_zip(DAE), "it is an archive"),
        ("a.dae", b"<!-- -->" + in_a_zip(DAE), "it is an archive"),
        ("a.dae", of_entities(DAE).encode(), "defines entities"),
        ("a.dae", of_entities(DAE).encode("utf-16"), "defines entities"),
        ("a.dae", repeating(30).encode(), "100000 nodes or more"),
    ],
)
def test_a_mesh_is_no_larger_than_its_file(name, content, words, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(Refused, match=words):
        read_mesh(tmp_path / name)


def test_the_triangles_of_a_mesh_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(mesh, "MAX_TRIANGLES", 15)
    for name, content in (("a.dae", repeating(2)), ("b.obj", 5 * OBJ)):
        (tmp_path / name).write_text(content)
        with pytest.raises(Refused, match="triangles or more; expected at most 15"):
            read_mesh(tmp_path / name)
    monkeypatch.setitem(mesh.GREATEST, ".stl", 10)
    (tmp_path / "c.stl").write_text(STL)
    with pytest.raises(Refused, match="at most 10 bytes"):
        read_mesh(tmp_path / "c.stl")


def test_nodes_of_a_mesh_move_what_they_repeat(tmp_path):
    pytest.importorskip("collada", reason="collada is not installed: make setup")
    text = repeating(1).replace('<node id="n1">', '<node id="n1"><translate>0 0 5</translate><scale>2 2 2</scale>')
    (tmp_path / "a.dae").write_text(text)
    read = read_mesh(tmp_path / "a.dae")
    assert len(read.faces) == 4 * len(FACES)
    np.testing.assert_allclose(np.unique(read.vertices, axis=0), np.unique(2.0 * CORNERS + [0, 0, 5], axis=0))


def test_files_that_a_mesh_names_are_not_opened(tmp_path):
    """A pipe, which would be waited for."""
    os.mkfifo(tmp_path / "pipe.mtl")
    (tmp_path / "a.obj").write_text(f"mtllib pipe.mtl\nusemtl a\n{OBJ}")
    image = '<library_images><image id="i"><init_from>pipe.mtl</init_from></image></library_images>'
    (tmp_path / "b.dae").write_text(DAE.replace("<library_geometries>", image + "<library_geometries>"))
    for name in ("a.obj", "b.dae"):
        assert len(read_mesh(tmp_path / name).faces) == len(FACES)


@pytest.mark.parametrize(
    ("hosts", "is_own"),
    [
        (["localhost:8080"], True),
        (["127.0.0.1:8080"], True),
        (["[::1]:8080"], True),
        (["localhost"], True),
        (["evil.example:8080"], False),  # resolved to this machine
        (["localhost:8080", "localhost:8080"], False),
        ([], False),
    ],
)
def test_a_request_is_for_this_machine(hosts, is_own):
    assert web.is_own("127.0.0.1", hosts) is is_own


def test_the_server_answers_its_own_name_alone():
    with web.serve("127.0.0.1", 0) as server, web.serve("127.0.0.1", server.server_port) as second:
        server.page = b"the page"
        assert second.server_port > server.server_port  # the next free one
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for host, path, expected in (
            (f"localhost:{server.server_port}", "/", (200, b"the page")),
            ("evil.example", "/", (403, None)),
            ("localhost", "/../secret", (404, None)),
        ):
            page = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
            page.request("GET", path, headers={"Host": host})
            answer = page.getresponse()
            assert answer.status == expected[0]
            assert expected[1] in (None, answer.read())
            page.close()
        server.shutdown()


def test_half_a_request_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(web._Handler, "timeout", 0.01)
    with web.serve("127.0.0.1", 0) as server:
        half = socket.create_connection(("127.0.0.1", server.server_port), timeout=30)
        half.sendall(b"GET / HTTP/1.1\r\nHost: localhost")
        server.handle_request()
        assert half.recv(100) == b""
        half.close()


def test_a_revolved_profile_is_closed_with_outward_faces():
    """By the divergence theorem: a double cone on a cylinder, below and above its origin."""
    n, profile = 24, [(0.0, -2.0), (1.0, -1.0), (1.0, 1.0), (0.0, 2.0)]
    solid = mesh.revolve(profile, n)
    a, b, c = np.moveaxis(solid.vertices[solid.faces], 1, 0)
    section = 0.5 * n * np.sin(2.0 * np.pi / n)
    assert np.sum(np.einsum("fi,fi->f", a, np.cross(b, c))) / 6.0 == pytest.approx(section * (2.0 + 2.0 / 3.0))
