"""Pictures by Pillow alone: where a point is seen, what hides what, and that nothing needs MuJoCo."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.body.mesh import box
from jax_aero.view import recording
from jax_aero.view.drawing import FORCE, LOST, PLUME, TRAIL, Camera, focal_length

pytest.importorskip("PIL.Image", reason="Pillow is not installed: make setup")
from jax_aero.view import labels, painter
from tests.view.conftest import near

CAMERA = Camera(np.array([1.0, -2.0, 1.5]), 30.0, -20.0, 4.0)
WIDTH, HEIGHT = 200, 120


@pytest.fixture
def canvas() -> painter._Canvas:
    return painter._Canvas(WIDTH, HEIGHT, CAMERA)


def test_a_point_is_seen_where_the_camera_has_it(canvas, agree):
    """Of the point looked at, one to the right of it, one above it, and one behind it on the same ray."""
    azimuth, elevation = np.deg2rad([CAMERA.azimuth_deg, CAMERA.elevation_deg])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    up = np.cross(right, ahead)
    points = CAMERA.look_at + np.array([0.0 * right, 0.5 * right, 0.5 * up, 3.0 * ahead])
    places, depths = canvas._project(points)
    metre = painter.OVERSAMPLING * focal_length(HEIGHT) / CAMERA.distance
    middle = painter.OVERSAMPLING * np.array([WIDTH, HEIGHT]) / 2
    expected = middle + 0.5 * metre * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    agree("pixels", places, expected, 1e-10)
    agree("depths [m]", depths, [4.0, 4.0, 4.0, 7.0], 1e-12)


def cube(centre, edge, colour):
    return painter.Solid(box(), centre, edge * np.eye(3), colour)


@pytest.mark.parametrize("order", [1, -1])
def test_what_is_nearer_hides_what_is_behind(canvas, order):
    azimuth, elevation = np.deg2rad([CAMERA.azimuth_deg, CAMERA.elevation_deg])
    ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    near, far = cube(CAMERA.look_at, 0.4, (200, 0, 0)), cube(CAMERA.look_at + ahead, 0.4, (0, 0, 200))
    canvas.paint([near, far][::order])
    red, _, blue = canvas.pixels()[HEIGHT // 2, WIDTH // 2].astype(int)
    assert red > 90
    assert blue == 0


def test_a_body_behind_the_camera_is_not_painted(canvas):
    before = canvas.pixels()
    azimuth = np.deg2rad(CAMERA.azimuth_deg)
    behind = CAMERA.look_at - 8.0 * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    canvas.paint([cube(behind, 0.4, (200, 0, 0))])
    canvas.shadow(cube(behind, 0.4, (200, 0, 0)))
    assert np.array_equal(canvas.pixels(), before)


def test_a_shadow_lies_on_the_ground_along_the_light(canvas):
    """Of a small cube 1 m above the ground: light that goes down by 1 m goes by 0.25 and 0.35 m to the side."""
    before = canvas.pixels().astype(int)
    canvas.shadow(cube(np.array([1.0, -2.0, 1.0]), 0.1, (200, 0, 0)))
    changed = np.argwhere(np.abs(canvas.pixels().astype(int) - before).sum(axis=2) > 60)
    places, _ = canvas._project(np.array([[1.25, -1.65, 0.0]]))
    assert np.abs(changed.mean(axis=0)[::-1] + 0.5 - places[0] / painter.OVERSAMPLING).max() < 1.5


def test_robot_thrusts_forces_and_paths_are_painted_without_mujoco(fallen, tmp_path):
    """In a process in which MuJoCo and JAX cannot be imported, as in an environment of `make demo`."""
    out = tmp_path / "painted.png"
    program = f"""
import sys
sys.modules.update(mujoco=None, jax=None, OpenGL=None)
from jax_aero import __main__ as commands
sys.exit(commands.main(["view", "snapshot", {str(fallen)!r}, "--renderer", "pillow", "--at", "18",
    "--out", {str(out)!r}, "--size", "640x360"]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    picture = np.asarray(painter.Image.open(out).convert("RGB"))[90:270, 160:480]
    assert near(picture, PLUME) > 300
    assert near(picture, FORCE) > 50
    assert near(picture, TRAIL) > 20


def test_a_ghost_is_translucent_and_in_the_same_scene(fallen):
    seen = recording.read(fallen)
    camera = Camera(seen.at(20.0).com, 32.0, -16.0, 3.3)
    alone = painter.Painter(seen, 160, 96).picture(20.0, camera).astype(int)
    earlier = replace(seen, signals={**seen.signals, "time": seen.signals["time"] + 3.0})
    ghost = painter.Painter(seen, 160, 96, ghost=earlier).picture(20.0, camera).astype(int)
    assert (np.abs(alone - ghost).sum(axis=2) > 20).sum() > 300


@pytest.mark.parametrize("engine", range(4))
@pytest.mark.parametrize("azimuth", [32.0, 122.0, 212.0])
def test_an_engine_that_has_stopped_is_coloured_and_in_a_ring(engine, azimuth, standing):
    """The ring is drawn over the robot, and shows the engine where it is hidden."""
    flight = standing(Path(rust.load_config("test2")["robot"]))
    camera = Camera(flight.at(1.0).com, azimuth, -16.0, 3.3)
    scene = painter.Painter(flight, 400, 400)
    assert near(scene.picture(1.0, camera), LOST) == 0
    assert list(scene.stopped(1.0, camera)) == []
    flight.signals["thrust"][:, engine] = 0.5
    picture, (place,) = scene.picture(1.0, camera), scene.stopped(1.0, camera)
    metre = scene.pixels_per_metre(camera)
    cosine = picture @ np.array(LOST) / (np.linalg.norm(picture.astype(float), axis=2) * np.linalg.norm(LOST))
    seen = np.argwhere(cosine > 0.995)[:, ::-1]
    assert not seen.size or np.linalg.norm(seen.mean(axis=0) - place) < 0.3 * metre
    ringed = labels.ring(picture, [place], metre)
    ring = np.argwhere((ringed != picture).any(axis=2))[:, ::-1]
    radii = np.linalg.norm(ring - place, axis=1)  # drawn inwards, 4 pixels wide, in whole pixels
    assert ring.size > 200
    assert labels.RING * metre - 6.0 < radii.min() < radii.max() < labels.RING * metre + 2.0
