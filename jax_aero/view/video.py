"""`jax-aero view video` and `snapshot`: a flight as a video, or several of its times in one picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jax_aero.base.files import complete_file
from jax_aero.base.terminal import Progress
from jax_aero.view import Refused, check_out, require
from jax_aero.view.drawing import Camera, Scene, Viewpoint, camera_at
from jax_aero.view.recording import Recording

HOLD = 1.5  # s for which the last picture stays, to read the outcome
PANELS = 6  # number of times in a snapshot by default
WEBP_QUALITY = 55  # of 100
MIN_PANEL = 64  # pixels, least width of one of several pictures side by side
BANDS = 0.13, 0.14  # shares of the height, above and below pictures side by side, for what is written
NARROW = 0.7  # height by width of a picture above which the camera keeps a larger distance, so that the robot fits in
DISTANCE = {"video": 3.3, "snapshot": 2.9}  # m, of the camera

Renderer = Literal["mujoco", "pillow"]
"""What draws: MuJoCo with OpenGL, or Pillow alone."""


def open_scene(
    renderer: Renderer, recording: Recording, width: int, height: int, ghost: Recording | None = None
) -> Scene:
    """Return a scene of a size [pixels], which is to be closed.

    Raises
    ------
    Refused
        If it cannot be drawn on this machine.
    """
    if renderer == "pillow":
        require(["PIL"], "drawing")
        from jax_aero.view.painter import Painter

        return Painter(recording, width, height, ghost)
    from jax_aero.view.offscreen import Studio

    return Studio(recording, width, height, ghost)


def frame_times(duration: float, fps: float, speed: float, start: float, end: float) -> list[float]:
    """Return the times [s] of a video's frames from `start` to `end`, limited to the flight's `duration` [s]."""
    step = speed / fps
    times = [start + i * step for i in range(int((end - start) / step + 1e-9) + 1)]
    if end >= duration:
        if times[-1] < end:
            times.append(end)
        times += [end] * round(HOLD * fps)
    return times


def write_video(
    recording: Recording,
    out: Path,
    *,
    ghost: Recording | None = None,
    beside: Sequence[Recording] = (),
    titles: Sequence[str] = (),
    renderer: Renderer = "mujoco",
    fps: float = 30.0,
    speed: float = 1.0,
    size: tuple[int, int] = (1280, 720),
    viewpoint: Viewpoint = "chase",
    start: float = 0.0,
    end: float | None = None,
    progress: Progress | None = None,
) -> int:
    """Draw and encode a video: of one flight, of two in one scene if there is a ghost, of several side by side.

    A camera follows each flight, but not a ghost. A flight that has ended stays as it ended. Those side by side may
    have `titles` other than their own.
    `out` is written completely or not at all. Returns the number of frames.

    Raises
    ------
    Refused
        If drawing or encoding is impossible on this machine, or if a number is invalid.
    """
    flights = [recording, *beside]
    duration = max(flight.duration for flight in (*flights, *([] if ghost is None else [ghost])))
    end = duration if end is None else min(end, duration)
    _check(fps, speed, size, start, end, out)
    if ghost is not None and beside:
        raise Refused("a ghost and a flight beside are given; expected at most one of them")
    if titles and len(titles) != len(flights):
        raise Refused(f"{len(titles)} titles are given; expected {len(flights)}, one of each flight side by side")
    flights = [replace(flight, title=title) for flight, title in zip(flights, titles, strict=False)] or flights
    panel = size[0] // len(flights)
    if panel < MIN_PANEL:
        raise Refused(f"{len(flights)} flights are given; expected at most {size[0] // MIN_PANEL} in {size[0]} pixels")
    require(["av", "PIL"] if out.suffix.lower() == ".mp4" else ["PIL"], "writing a video")
    times = frame_times(duration, fps, speed, start, end)
    with complete_file(out) as draft, ExitStack() as opened:
        bands = tuple(round(share * size[1]) for share in BANDS) if beside else (0, 0)
        height = size[1] - sum(bands)
        # The last one is as wide as what the others leave of the picture.
        widths = [*[panel] * len(beside), size[0] - panel * len(beside)]
        scenes = [
            opened.enter_context(open_scene(renderer, flight, width, height, ghost))
            for flight, width in zip(flights, widths, strict=True)
        ]
        distance = _distance("video", panel, height) if beside else DISTANCE["video"]

        def frame(time: float) -> Any:
            cameras = [camera_at(scene.recording, time, viewpoint, distance) for scene in scenes]
            return _row(scenes, bands, cameras, time, end) if beside else _single(scenes[0], cameras[0], time, end)

        _ENCODERS[out.suffix.lower()](draft, _frames(frame, times, progress), fps, size)
    return len(times)


def _distance(kind: str, width: int, height: int) -> float:
    """Return the camera's distance for a picture of this size [m]."""
    return DISTANCE[kind] * max(1.0, NARROW * height / width)


def _frames(draw: Callable[[float], Any], times: Sequence[float], progress: Progress | None) -> Iterator[Any]:
    """Yield the pixels (h, w, 3) of every frame; repeated times are drawn once."""
    drawn_at, pixels = -1.0, np.zeros((0, 0, 3), dtype=np.uint8)
    for number, time in enumerate(times):
        if time != drawn_at:
            drawn_at, pixels = time, draw(time)
        yield pixels
        if progress is not None:
            progress(number + 1, len(times))


def _single(scene: Scene, camera: Camera, time: float, end: float) -> Any:
    """Return one scene with all text."""
    from jax_aero.view.labels import letter_video, ring

    recording = scene.recording
    scale = scene.pixels_per_metre(camera)
    pixels = ring(scene.picture(time, camera), scene.stopped(time, camera), scale)
    ended = [flight for flight in (recording, scene.ghost) if flight is not None and time >= flight.duration]
    return letter_video(pixels, recording, time, scale, scene.ghost, ended=ended, end=end)


def _row(scenes: Sequence[Scene], bands: tuple[int, ...], cameras: Sequence[Camera], time: float, end: float) -> Any:
    """Return scenes side by side, with few words that remain legible when the picture is small."""
    from jax_aero.view.labels import letter_row, ring

    # Arrows of forces would hide a robot this small, and nothing would name them.
    scale = scenes[0].pixels_per_metre(cameras[0])
    pictures = [
        ring(scene.picture(time, camera, forces=False), scene.stopped(time, camera), scale)
        for scene, camera in zip(scenes, cameras, strict=True)
    ]
    return letter_row(pictures, bands, [scene.recording for scene in scenes], time, end, scale)


def _encode_mp4(draft: Path, frames: Iterator[Any], fps: float, size: tuple[int, int]) -> None:
    import av

    with av.open(draft, "w", format="mp4") as film:
        stream: Any = film.add_stream(_encoder(), rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.options = {"crf": "20", "preset": "medium"}
        for pixels in frames:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        film.mux(stream.encode())


def _encode_pictures(draft: Path, frames: Iterator[Any], fps: float, _size: tuple[int, int]) -> None:
    """Write an animated GIF, with 256 colours per frame, or WebP; it repeats."""
    from PIL import Image

    pictures: list[Any] = [Image.fromarray(pixels) for pixels in frames]
    options: dict[str, Any] = {
        "duration": _durations(len(pictures), 1000.0 / fps),
        "quality": WEBP_QUALITY,
        "method": 4,
    }
    if draft.suffix.lower() == ".gif":
        pictures = [picture.quantize(256) for picture in pictures]
        # Times of a GIF are hundredths of a second, and players ignore durations below two of them.
        durations = [10 * max(hundredths, 2) for hundredths in _durations(len(pictures), 100.0 / fps)]
        options = {"duration": durations, "optimize": False}
    pictures[0].save(draft, save_all=True, append_images=pictures[1:], loop=0, **options)


def _durations(count: int, period: float) -> list[int]:
    """Return whole durations of frames, each of which ends at the nearest one, so that the total time is right."""
    return [end - start for start, end in pairwise(round(number * period) for number in range(count + 1))]


_ENCODERS = {".mp4": _encode_mp4, ".gif": _encode_pictures, ".webp": _encode_pictures}


def _encoder() -> str:
    import av

    return "libx264" if "libx264" in av.codecs_available else "mpeg4"


def _check(fps: float, speed: float, size: tuple[int, int], start: float, end: float, out: Path) -> None:
    if not 1.0 <= fps <= 240.0:
        raise Refused(f"fps is {fps:g}; expected 1 to 240")
    if not 1e-3 <= speed <= 1e3:
        raise Refused(f"speed is {speed:g}; expected a positive factor from 0.001 to 1000")
    if any(not 64 <= edge <= 4096 or edge % 2 for edge in size):
        raise Refused(f"size is {size[0]}x{size[1]}; expected even numbers from 64 to 4096, e.g. 1280x720")
    if not 0.0 <= start < end:
        raise Refused(f"the video would run from {start:g} to {end:g} s; expected a start before the end of the flight")
    check_out(out, *_ENCODERS)


def write_snapshot(
    recording: Recording,
    out: Path,
    times: Sequence[float] = (),
    *,
    renderer: Renderer = "mujoco",
    size: tuple[int, int] = (1920, 1080),
    viewpoint: Viewpoint = "chase",
    progress: Progress | None = None,
) -> None:
    """Draw one time, or several side by side above the path as in the paper's Fig. 5a; `out` is a PNG.

    Raises
    ------
    Refused
        If drawing is impossible on this machine, or if a time is outside the flight.
    """
    check_out(out, ".png")
    if any(not 64 <= edge <= 8192 for edge in size):
        raise Refused(f"size is {size[0]}x{size[1]}; expected 64 to 8192, e.g. 1920x1080")
    if len(times) > 1 and size[0] < MIN_PANEL * len(times):
        raise Refused(f"{len(times)} moments are given; expected at most {size[0] // MIN_PANEL} in {size[0]} pixels")
    chosen = [float(t) for t in times] or [float(t) for t in np.linspace(0.0, recording.duration, PANELS)]
    for time in chosen:
        if not 0.0 <= time <= recording.duration:
            raise Refused(f"there is no moment at {time:g} s; expected 0 to {recording.duration:g} s")
    require(["PIL"], "drawing a snapshot")
    from PIL import Image

    from jax_aero.view.labels import letter_video

    letters, is_single = max(size[1] // 38, 9), len(chosen) == 1
    top = int(4.6 * letters)
    panel = size if is_single else (size[0] // len(chosen), size[1] - top - int(0.27 * size[1]))
    distance = DISTANCE["video"] if is_single else _distance("snapshot", *panel)
    pictures = []
    with open_scene(renderer, recording, *panel) as scene:
        for number, time in enumerate(chosen, 1):
            camera = camera_at(recording, time, viewpoint, distance)
            pictures.append(scene.picture(time, camera))
            if progress is not None:
                progress(number, len(chosen))
        scale = scene.pixels_per_metre(camera)
    if is_single:
        end = recording.duration
        pixels = letter_video(pictures[0], recording, chosen[0], scale, ended=[recording], end=end)
    else:
        pixels = _strip(recording, chosen, pictures, size, top, letters, scale)
    with complete_file(out) as draft:
        Image.fromarray(pixels).save(draft, format="PNG")


def _strip(
    recording: Recording,
    times: list[float],
    pictures: Sequence[Any],
    size: tuple[int, int],
    top: int,
    letters: int,
    scale: float,
) -> Any:
    """Return numbered pictures side by side; below them the path from the side with the same numbers."""
    from PIL import Image, ImageDraw

    from jax_aero.view import labels

    width, height = size
    sheet = Image.new("RGB", size, labels.PAPER)
    panel = width // len(times), len(pictures[0])
    for i, picture in enumerate(pictures):
        sheet.paste(Image.fromarray(picture), (i * panel[0], top))
    draw = ImageDraw.Draw(sheet, "RGBA")
    labels.text(draw, (letters, 0.5 * letters), recording.title, int(1.3 * letters), labels.INK)
    labels.badge(draw, (width - int(1.2 * letters), int(1.4 * letters)), recording, letters, "rm")
    captions = [
        f"{i}    {time:.1f} s    {labels.rotation_error(recording.at(time))}" for i, time in enumerate(times, 1)
    ]
    margin = 0.7 * letters
    longest = max(labels.font(letters).getlength(words) for words in captions)
    size_of_caption = max(int(letters * min(1.0, (panel[0] - 2 * margin) / longest)), 1)
    for i, words in enumerate(captions):
        left = i * panel[0]
        labels.text(draw, (left + margin, top - 0.5 * letters), words, size_of_caption, labels.INK, "lb")
        if i:
            draw.line((left, top, left, top + panel[1]), fill=labels.PAPER, width=max(letters // 6, 2))
    base = height - int(2.2 * letters)
    split = int(0.26 * width)
    labels.legend(draw, (letters, base), letters, scale)
    box = (split, top + panel[1] + int(1.6 * letters), width - 2 * letters, base)
    labels.profile(draw, box, recording, times, letters)
    return np.asarray(sheet)
