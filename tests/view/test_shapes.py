"""A robot of meshes can be looked at; attitude error and lean are two angles; foreign sites are turned away."""

import re
import socket
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from jax_aero import places, rust
from jax_aero.view.recording import Instant
from jax_aero.view.shapes import look_of


def test_links_with_meshes_alone_are_drawn_as_the_air_sees_them():
    robot = rust.Robot(str(places.find("robot", "sparrow")))
    table = tomllib.loads(robot.toml_text)
    shown = look_of(robot)
    assert shown.without_shape == ()
    mesh = '<geometry><mesh filename="package://bird/body.stl" scale="1 1 1"/></geometry>'
    text = re.sub(r"<geometry>.*?</geometry>", mesh, robot.urdf_text, flags=re.S)
    meshed = SimpleNamespace(
        toml_text=robot.toml_text, urdf_text=text, joint_names=robot.joint_names, body_names=robot.body_names
    )
    look = look_of(meshed)
    assert set(look.without_shape) == {shape.name for shape in shown.shapes if shape.role != "strut"}
    drawn = {shape.name: shape for shape in look.shapes if shape.role != "strut"}
    assert set(drawn) == {entry["frame"] for entry in table["aero_links"]} & set(look.without_shape)
    entry = next(
        entry for entry in table["aero_links"] if not entry.get("is_sphere", False) and entry["frame"] in drawn
    )
    shape = drawn[entry["frame"]]
    assert shape.size == (0.5 * entry["diameter"], 0.5 * entry["diameter"], entry["length"])


def test_lean_is_measured_from_the_vertical_not_from_the_reference():
    angle = 0.3
    turned = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    nothing = np.zeros(3)
    now = Instant(0.0, nothing[None], turned[None], nothing, nothing, nothing, 0.0, nothing, nothing, nothing)
    assert abs(now.lean - angle) < 1e-12


def test_a_foreign_site_is_turned_away():
    viser = pytest.importorskip("viser")
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    from jax_aero.view.origins import own_origins

    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    with own_origins("127.0.0.1"):
        server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    try:
        url = f"ws://127.0.0.1:{server.get_port()}"
        with pytest.raises(InvalidStatus) as refusal:
            connect(url, origin="http://evil.example")
        assert refusal.value.response.status_code == 403
        for origin in (None, f"http://localhost:{server.get_port()}"):
            try:
                connect(url, origin=origin).close()
            except InvalidStatus as other:  # the server may want more of a client, but not another origin
                assert other.response.status_code != 403  # noqa: PT017
    finally:
        server.stop()
