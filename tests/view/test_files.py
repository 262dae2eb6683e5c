"""Videos and snapshots: the right frames, none of them empty, and nothing half-finished left behind."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jax_aero import __main__ as commands
from jax_aero.base import places
from jax_aero.commands import view as cli
from jax_aero.view import Refused, offscreen, recording, video
from jax_aero.view.drawing import FORCE, GHOST, camera_at
from jax_aero.view.painter import Painter
from tests.view.conftest import near

av = pytest.importorskip("av", reason="PyAV is not installed: make setup")
Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed: make setup")
mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: make setup")


@pytest.fixture(scope="module")
def seen(fallen):
    return recording.read(fallen)


@pytest.fixture(scope="module")
def _can_draw():
    try:
        offscreen.find_backend()
    except Refused as reason:
        pytest.skip(str(reason))


def colours(picture: np.ndarray) -> int:
    return len(np.unique(picture.reshape(-1, 3), axis=0))


def clip_from_17_s(result: Path, out: Path, *, end: str, size: str) -> list[str]:
    """The words of a command for a clip with five frames a second."""
    times = ["--start", "17", "--end", end, "--fps", "5"]
    return ["view", "video", str(result), "--out", str(out), *times, "--size", size]


@pytest.mark.usefixtures("_can_draw")
def test_a_clip_has_the_frames_that_were_asked_for(fallen, tmp_path, capsys):
    out = tmp_path / "clip.mp4"
    words = clip_from_17_s(fallen, out, end="18", size="320x180")
    assert commands.main(words) == 0
    assert capsys.readouterr().out.strip() == str(out)
    with av.open(out) as film:
        stream = film.streams.video[0]
        assert (stream.average_rate, stream.width, stream.height) == (5, 320, 180)
        frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(stream)]
    assert len(frames) == 6
    assert min(colours(frame) for frame in frames) > 500
    assert np.abs(frames[0] - frames[-1]).max() > 60
    assert [entry.name for entry in tmp_path.iterdir()] == ["clip.mp4"]


@pytest.mark.usefixtures("_can_draw")
def test_a_gif_has_its_frames_and_what_is_there_is_spared(fallen, tmp_path, capsys):
    out = tmp_path / "clip.gif"
    words = clip_from_17_s(fallen, out, end="17.4", size="160x96")
    assert commands.main(words) == 0
    with Image.open(out) as film:
        assert (film.n_frames, film.size, film.info["duration"], film.info["loop"]) == (3, (160, 96), 200, 0)
    before = out.read_bytes()
    for attempt in (words, ["view", "snapshot", str(fallen), "--out", str(tmp_path / "clip.png")]):
        (tmp_path / "clip.png").write_bytes(b"mine")
        capsys.readouterr()
        assert commands.main(attempt) == 2
        assert "is there already; choose another --out, or --overwrite it" in capsys.readouterr().err
    assert out.read_bytes() == before


@pytest.mark.usefixtures("_can_draw")
def test_two_flights_side_by_side_are_each_drawn_alone_and_with_their_outcomes(fallen, seen, tmp_path):
    """The right half is the same flight two seconds later, which has ended: it repeats its last picture."""
    later = replace(seen, signals={**seen.signals, "time": seen.signals["time"] - 2.0})
    out = tmp_path / "pair.webp"
    times = {"start": seen.duration - 1.0, "end": seen.duration - 0.5, "fps": 2.0}
    assert video.write_video(seen, out, beside=[later], size=(320, 128), **times) == 2
    with Image.open(out) as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (2, (320, 128), 0)
        halves = []
        for number in range(2):
            film.seek(number)
            picture = np.asarray(film.convert("RGB")).astype(int)
            halves.append((picture[:110, :158], picture[:110, 162:]))
    for half in (*halves[0], *halves[1]):
        assert colours(half) > 500
        assert near(half, FORCE) < 5  # nothing would say what the arrows are
    (left, right), (left_later, right_later) = halves
    assert np.abs(left - left_later).mean() > 10.0 * np.abs(right - right_later).mean()
    with pytest.raises(Refused, match="expected at most one of them"):
        video.write_video(seen, out, ghost=later, beside=[later])
    with pytest.raises(Refused, match="3 flights are given; expected at most 2 in 128 pixels"):
        video.write_video(seen, out, beside=[later, later], size=(128, 96))
    with pytest.raises(Refused, match="1 titles are given; expected 2"):
        video.write_video(seen, out, beside=[later], titles=["one"])


@pytest.mark.parametrize("fps", [25.0, 30.0, 48.0])
def test_a_gif_keeps_its_time(fps, tmp_path):
    """Frames of 3 and 4 hundredths of a second, for 30 a second."""
    frames = np.random.default_rng(0).integers(0, 255, (24, 8, 8, 3), np.uint8)
    video._encode_pictures(tmp_path / "clip.gif", iter(frames), fps, (8, 8))
    durations = []
    with Image.open(tmp_path / "clip.gif") as film:
        for number in range(film.n_frames):
            film.seek(number)
            durations.append(film.info["duration"])
    assert len(durations) == 24
    assert abs(sum(durations) - 24e3 / fps) <= 5.0


def test_a_video_ends_where_the_flight_ends(seen, agree):
    times = video.frame_times(seen.duration, fps=10.0, speed=2.0, start=0.0, end=seen.duration)
    np.testing.assert_allclose(np.diff(times[:100]), 0.2)
    assert times[-15:] == [seen.duration] * 15
    agree(
        "time of the last frame",
        video.frame_times(seen.duration, fps=30.0, speed=1.0, start=1.0, end=2.0)[-1],
        2.0,
        1e-12,
    )


@pytest.mark.slow
@pytest.mark.usefixtures("_can_draw")
def test_a_snapshot_shows_robot_forces_thrusts_and_wind(fallen, tmp_path):
    several, one, before = (tmp_path / f"{name}.png" for name in ("several", "one", "before"))
    for path, options in ((several, []), (one, ["--at", "18"]), (before, ["--at", "1", "--camera", "side"])):
        words = ["view", "snapshot", str(fallen), *options, "--out", str(path), "--size", "640x360"]
        assert commands.main(words) == 0
    pictures = {path.stem: np.asarray(Image.open(path).convert("RGB")) for path in (several, one, before)}
    assert {picture.shape for picture in pictures.values()} == {(360, 640, 3)}
    assert min(colours(picture) for picture in pictures.values()) > 1000
    middle = {name: picture[90:270, 160:480] for name, picture in pictures.items()}
    plume, force = (230, 159, 0), (0, 114, 178)
    assert near(middle["one"], plume) > 300
    assert near(middle["one"], force) > 50
    assert near(middle["before"], force) == 0  # no wind yet


@pytest.mark.usefixtures("_can_draw")
def test_a_ghost_flies_in_the_same_picture(seen):
    """Both robots are where their flights have them: the ghost is the same flight, a second later."""
    later = replace(seen, signals={**seen.signals, "time": seen.signals["time"] - 1.0})
    with offscreen.Studio(seen, 160, 96, ghost=later) as studio:
        picture = studio.picture(12.0, camera_at(seen, 12.0, "chase", 3.3))
        ghosts = [solid.position for solid in studio.bodies(12.0) if solid.colour == GHOST]
    alone = [solid.position for solid in Painter(seen, 160, 96).bodies(13.0)]
    np.testing.assert_array_equal(ghosts, alone[: len(seen.look.shapes)])
    blue = picture[..., 2].astype(int) - picture[..., 0]
    assert blue[:6].mean() > 2.0 * blue[-6:].mean(), "the sky is above, and the ground is grey"


@pytest.mark.usefixtures("_can_draw")
def test_another_robot_is_drawn_too(standing, tmp_path):
    """Nothing is about iRonCub alone; this one stands still."""
    flight = standing(places.HOME / "configs/robot/sparrow.toml")
    video.write_snapshot(flight, tmp_path / "sparrow.png", [0.0], size=(320, 180))
    assert colours(np.asarray(Image.open(tmp_path / "sparrow.png"))) > 500


@pytest.mark.usefixtures("_can_draw")
def test_an_interrupted_video_leaves_nothing(fallen, tmp_path, monkeypatch, capsys):
    out = tmp_path / "long.mp4"
    out.write_text("an older one")
    seen_halfway = []

    @contextmanager
    def bar(_unit):
        yield interrupt

    def interrupt(done, total):
        if done == 60:  # the encoder looks ahead before it writes anything
            seen_halfway.extend(sorted(path.name for path in tmp_path.iterdir()))
            raise KeyboardInterrupt

    monkeypatch.setattr(cli, "progress_bar", bar)
    words = ["view", "video", str(fallen), "--out", str(out), "--size", "128x96", "--overwrite"]
    assert commands.main(words) == 130
    assert "interrupted" in capsys.readouterr().err
    assert len(seen_halfway) == 2  # the draft was there
    assert out.read_text() == "an older one"
    assert [path.name for path in tmp_path.iterdir()] == ["long.mp4"]


def test_no_way_to_draw_is_said_so(seen, tmp_path, monkeypatch):
    offscreen.find_backend.cache_clear()
    monkeypatch.setattr(offscreen, "_PROBE", "raise SystemExit(1)")
    with pytest.raises(Refused, match=r"no offscreen OpenGL here \(tried .*libosmesa6"):
        video.write_snapshot(seen, tmp_path / "a.png", [0.0])
    offscreen.find_backend.cache_clear()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["view", "video", "--size", "321x180"], "even numbers"),
        (["view", "video", "--fps", "0"], "fps is 0"),
        (["view", "video", "--speed", "-1"], "positive factor"),
        (["view", "video", "--speed", "1e-9"], "speed is 1e-09; expected"),
        (["view", "video", "--start", "30"], "would run from 30 to 21."),
        (["view", "video", "--out", "clip.avi"], "does not end in .mp4"),
        (["view", "snapshot", "--at", "22"], "there is no moment at 22 s; expected 0 to 21."),
        (["view", "snapshot", "--out", "a.jpg"], "does not end in .png"),
        (
            ["view", "snapshot", "--size", "128x96", "--at", "0", "1", "2"],
            "3 moments are given; expected at most 2 in 128",
        ),
        (["view", "snapshot", "--out", f"nowhere{os.sep}a.png", "--at", "0"], "there is no folder `nowhere`"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(words, expected, fallen, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert commands.main([*words[:2], str(fallen), *words[2:]]) == 2
    assert expected in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
