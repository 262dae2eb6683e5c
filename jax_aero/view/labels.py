"""Text in pictures (Pillow): title, numbers, outcome, scale, and elapsed time."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jax_aero import rust
from jax_aero.base.quantities import shown
from jax_aero.base.result import UPRIGHT
from jax_aero.body.urdf import Vector
from jax_aero.view import drawing
from jax_aero.view.drawing import Colour
from jax_aero.view.recording import Instant, Recording

SIGNALS = rust.signals()

INK: Colour = (32, 36, 44)
SOFT: Colour = (88, 94, 104)
PAPER: Colour = (255, 255, 255)
RING = 0.2  # m, radius of the ring around an engine that has stopped


@functools.lru_cache
def font(size: int) -> Any:
    """Return Pillow's own font at a size in pixels, which needs no installation."""
    return ImageFont.load_default(size=size)


def letter_video(
    pixels: Any,
    recording: Recording,
    time: float,
    pixels_per_metre: float,
    ghost: Recording | None = None,
    *,
    ended: Sequence[Recording],
    end: float,
) -> Any:
    """Add all text to a frame (h, w, 3) of a video until `end` [s], with the outcomes of `ended` flights."""
    picture = Image.fromarray(pixels)
    draw = ImageDraw.Draw(picture, "RGBA")
    width, height = picture.size
    size = max(height // 34, 9)
    margin = size
    now = recording.at(time)
    text(draw, (margin, margin), recording.title, int(1.25 * size), INK)
    below = margin + int(1.7 * size)
    if ghost is not None:
        text(draw, (margin, below), f"ghost: {ghost.title}", size, drawing.GHOST)
        below += int(1.5 * size)
    text(draw, (margin, below), f"{time:.1f} s", size, SOFT)
    lines = [
        shown(SIGNALS["wind"], np.linalg.norm(now.wind)).said(".1f"),
        rotation_error(now),
        f"off course {np.linalg.norm(now.com - now.com_setpoint):.2f} m",
        f"speed {np.linalg.norm(now.com_velocity):.1f} m/s",
        f"height {now.com[2]:.1f} m",
        stopped(now),
    ]
    for i, line in enumerate(lines):
        text(draw, (width - margin, margin + int(1.35 * i * size)), line, size, INK, anchor="ra")
    legend(draw, (margin, height - 2 * margin), size, pixels_per_metre)
    flights = [recording] if ghost is None else [recording, ghost]
    for flight in flights:
        below += int(2.5 * size)
        if any(flight is one for one in ended):
            words = flight.verdict if flight is recording else f"ghost: {flight.verdict}"
            badge(draw, (margin + size // 2, below), flight, size, "lm", words)
    _bar(draw, picture.size, time / max(end, 1e-9))
    return np.asarray(picture)


def letter_row(
    pictures: Sequence[Any],
    bands: Sequence[int],
    flights: Sequence[Recording],
    time: float,
    end: float,
    pixels_per_metre: float,
) -> Any:
    """Join pictures (h, w, 3), with rows of text above and below, `bands`, and a clock that runs until `end` [s].

    Above each is its flight's title, below it the errors and, at its end, the outcome. Letters are twice as large as
    those of a whole video.
    """
    height, panel = pictures[0].shape[:2]
    row = np.hstack(pictures)
    paper = [np.full((band, *row.shape[1:]), PAPER, np.uint8) for band in bands]
    joined = Image.fromarray(np.vstack([paper[0], row, paper[1]]))
    draw = ImageDraw.Draw(joined, "RGBA")
    titles = [_lines(flight.title) for flight in flights]
    size = max(int(0.38 * bands[0]), 9)
    longest = max(font(size).getlength(words) for lines in titles for words in lines)
    letters = int(size * min(1.0, (panel - size) / longest))
    upper, lower = bands[0] + height + bands[1] // 4 + 1, bands[0] + height + 3 * bands[1] // 4 - 1
    for number, (flight, lines) in enumerate(zip(flights, titles, strict=True)):
        middle = number * panel + panel // 2
        for line, words in enumerate(lines):
            text(draw, (middle, bands[0] * (1 + 2 * line) / (2 * len(lines))), words, letters, INK, "mm")
        if time >= flight.duration:
            words = _outcome(flight)
            share = min(1.0, (panel - size) / font(letters).getlength(words))
            badge(draw, (middle, upper), flight, int(0.9 * share * letters), "mm", words)
        else:
            text(draw, (middle, upper), errors(flight.at(time)), letters, INK, "mm")
        if words := stopped(flight.at(time)):
            place = middle, bands[0] + height - 3 * letters // 2
            label(draw, place, words, int(0.9 * letters), drawing.LOST, "mm")
        if number:
            draw.rectangle((number * panel - 1, 0, number * panel, bands[0] + height), fill=PAPER)
    wind = max(np.linalg.norm(flight.at(time).wind) for flight in flights)
    text(draw, (joined.width // 2, lower), f"{time:.1f} s, wind {wind:.0f} m/s", letters, INK, "mm")
    left, right = letters // 2, letters // 2 + pixels_per_metre
    draw.rectangle((left, lower - 1, right, lower + 1), fill=INK)
    text(draw, (right + letters // 2, lower), "1 m", letters, INK, "lm")
    right = joined.width - letters // 2
    for words, colour in (("path", drawing.TRAIL), ("reference", drawing.REFERENCE)):
        text(draw, (right, lower), words, letters, INK, "rm")
        right -= int(font(letters).getlength(words)) + letters // 2
        draw.rectangle((right - 2 * letters, lower - 1, right, lower + 1), fill=colour)
        right -= 3 * letters
    _bar(draw, joined.size, time / end)
    return np.asarray(joined)


def ring(pixels: Any, places: Iterable[Vector], pixels_per_metre: float) -> Any:
    """Return a picture (h, w, 3) with a ring around each place, of an engine that has stopped."""
    picture = Image.fromarray(pixels)
    draw = ImageDraw.Draw(picture)
    for place in places:
        draw.circle(tuple(place), RING * pixels_per_metre, outline=drawing.LOST, width=max(picture.height // 90, 2))
    return np.asarray(picture)


def rotation_error(now: Instant) -> str:
    """Return the rotation error in words."""
    return shown(SIGNALS["rotation_error"], now.rotation_error).said(".0f")


def errors(now: Instant) -> str:
    """Return rotation error and distance of the centre of mass from its reference in few words."""
    return f"error {np.rad2deg(now.rotation_error):.0f}°, {np.linalg.norm(now.com - now.com_setpoint):.1f} m"


def stopped(now: Instant) -> str:
    """Return in words how many engines have stopped, or nothing."""
    count = int(np.sum(now.stopped))
    return f"{count} of {len(now.thrust)} engines stopped" if count else ""


def _outcome(flight: Recording) -> str:
    """Return how a flight ended, in few words: why it is lost, with the speed of the touch-down if it came down."""
    speed = np.linalg.norm(flight.at(flight.duration).com_velocity)
    words = {"landed": f"landed at {speed:.1f} m/s", "crashed": f"crashed at {speed:.1f} m/s"}
    lost = f"lost: {flight.lost_reason}" if flight.lost_reason else flight.verdict
    return words.get(flight.outcome, lost)


def _bar(draw: ImageDraw.ImageDraw, size: tuple[int, int], share: float) -> None:
    """Draw the share of a video that is over at the bottom of a picture of this size."""
    width, height = size
    draw.rectangle((0, height - max(height // 130, 2), width * min(share, 1.0), height), fill=(*drawing.FORCE, 255))


def _lines(words: str) -> list[str]:
    """Return words in two lines of nearly equal length, a single word in one."""
    spaces = [place for place, letter in enumerate(words) if letter == " "]
    if not spaces:
        return [words]
    split = min(spaces, key=lambda place: abs(2 * place - len(words)))
    return [words[:split], words[split + 1 :]]


def text(
    draw: ImageDraw.ImageDraw, place: tuple[float, float], words: str, size: int, colour: Colour, anchor: str = "la"
) -> None:
    """Write text with a light outline, legible on any background."""
    draw.text(
        place, words, font=font(size), fill=colour, anchor=anchor, stroke_width=max(size // 12, 1), stroke_fill=PAPER
    )


def legend(draw: ImageDraw.ImageDraw, place: tuple[float, float], size: int, pixels_per_metre: float) -> None:
    """Draw the legend of colours, upwards from the bottom line, with bars of the length of the named quantity."""
    scales, force = drawing.SCALES, drawing.REFERENCE_FORCE
    rows: list[tuple[Colour, float, str]] = [
        (drawing.TRAIL, 0.2, "its path"),
        (drawing.REFERENCE, 0.2, "reference of the centre of mass"),
        (drawing.WIND, 0.2, "wind"),
        (drawing.PLUME, scales["thrust"] * 100.0, "thrust 100 N"),
        (drawing.FORCE, scales["force"] * force, f"aerodynamic force {force:g} N"),
    ]
    longest = max(length for _, length, _ in rows) * pixels_per_metre
    for i, (colour, length, words) in enumerate(rows):
        middle = place[1] - 1.35 * i * size
        bar = length * pixels_per_metre
        thick = max(size // 7, 1)
        draw.rectangle((place[0], middle - thick, place[0] + bar, middle + thick), fill=colour)
        text(draw, (place[0] + longest + 0.6 * size, middle), words, int(0.85 * size), SOFT, anchor="lm")


def badge(
    draw: ImageDraw.ImageDraw,
    place: tuple[int, int],
    recording: Recording,
    size: int,
    anchor: str,
    words: str | None = None,
) -> None:
    """Draw the outcome, or `words` instead, on a background of the outcome's colour."""
    colour = drawing.COMPLETED if recording.outcome in UPRIGHT else drawing.LOST
    label(draw, place, recording.verdict if words is None else words, size, colour, anchor)


def label(
    draw: ImageDraw.ImageDraw, place: tuple[int, int], words: str, size: int, colour: Colour, anchor: str
) -> None:
    """Write light text on a background of a colour."""
    left, top, right, bottom = draw.textbbox(place, words, font=font(size), anchor=anchor)
    pad = 0.45 * size
    draw.rounded_rectangle((left - pad, top - pad, right + pad, bottom + pad), radius=pad, fill=(*colour, 255))
    draw.text(place, words, font=font(size), fill=PAPER, anchor=anchor)


def profile(
    draw: ImageDraw.ImageDraw, box: tuple[int, int, int, int], recording: Recording, times: list[float], size: int
) -> None:
    """Draw the path from the side, or from above if it turns, to one scale, with the times marked and numbered."""
    s = recording.signals
    left, top, right, bottom = box
    turns = float(np.ptp(s["com_setpoint"][:, 1])) > 2.0
    across = int(np.argmax(np.ptp(s["com_position"][:, :2], axis=0)))
    columns = [0, 1] if turns else [across, 2]
    path, wanted = s["com_position"][:, columns], s["com_setpoint"][:, columns]
    everything = np.concatenate([path, wanted])
    low, high = everything.min(axis=0), everything.max(axis=0)
    low[1] = min(low[1], 0.0)
    room = np.array([right - left, bottom - top])
    metre = float(np.min(room / np.maximum(high - low, 1.0)))  # pixels
    span = room / metre
    span[0] = min(span[0], max(high[0] - low[0], 0.5 * span[1]))
    right = left + round(metre * float(span[0]))

    def pixel(point: Vector) -> tuple[float, float]:
        x, y = metre * (point - low)
        return left + float(x), bottom - float(y)

    draw.line((left, bottom, right, bottom), fill=SOFT, width=1)
    draw.line((left, bottom, left, top), fill=SOFT, width=1)
    for x in _ticks(low[0], low[0] + span[0], max(round((right - left) / (4.0 * size)), 2)):
        place = pixel(np.array([x, low[1]]))
        draw.line((*place, place[0], place[1] + 0.4 * size), fill=SOFT, width=1)
        text(draw, (place[0], place[1] + 0.5 * size), f"{x:g} m", int(0.75 * size), SOFT, anchor="ma")
    for z in _ticks(low[1], low[1] + span[1], 3):
        place = pixel(np.array([low[0], z]))
        draw.line((place[0] - 0.4 * size, place[1], *place), fill=SOFT, width=1)
        text(draw, (place[0] - 0.6 * size, place[1]), f"{z:g} m", int(0.75 * size), SOFT, anchor="rm")
    view = "from above" if turns else f"height over {'xy'[across]}"
    text(draw, (right + size, bottom), view, int(0.75 * size), SOFT, "ls")
    draw.line([pixel(p) for p in (*wanted[::10], wanted[-1])], fill=drawing.REFERENCE, width=max(size // 8, 1))
    draw.line([pixel(p) for p in (*path[::10], path[-1])], fill=drawing.TRAIL, width=max(size // 6, 2))
    radius, letters = 0.62 * size, font(int(0.8 * size))
    marks: list[tuple[tuple[float, float], str]] = []
    for number, time in enumerate(times, start=1):
        x, y = pixel(recording.at(time).com[columns])
        near = (i for i, ((u, v), _) in enumerate(marks) if np.hypot(x - u, y - v) < 2.0 * radius)
        if (same := next(near, None)) is None:
            marks.append(((x, y), str(number)))
        else:
            marks[same] = marks[same][0], f"{marks[same][1]}, {number}"
    for (x, y), numbers in marks:  # the first number is at its place
        more = letters.getlength(numbers) - letters.getlength(numbers.partition(",")[0])
        frame = (x - radius, y - radius, x + radius + more, y + radius)
        draw.rounded_rectangle(frame, radius=radius, fill=PAPER, outline=INK, width=2)
        draw.text((x + 0.5 * more, y), numbers, font=letters, fill=INK, anchor="mm")


def _ticks(low: float, high: float, about: int) -> list[float]:
    """Return round numbers between two limits."""
    coarse = (high - low) / about
    power = 10.0 ** np.floor(np.log10(coarse))
    step = power * min((f for f in (1.0, 2.0, 5.0, 10.0) if f >= coarse / power), default=10.0)
    return [round(float(i * step), 9) for i in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]
