"""Data for the pages of `rust/lab/page`, and a flight as a self-contained HTML file."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.files import complete_file
from jax_aero.view import Refused, check_out, drawing
from jax_aero.view.recording import Recording
from jax_aero.view.shapes import Look, Mount, Shape

TEMPLATE = Path(__file__).with_name("flight.html")
"""The page without a flight, which `make lab` builds."""

RATE = 50.0
"""Samples of a flight in the page [1/s]."""

PLACE = "/*FLIGHTS*/null"
"""Text in the template that is replaced by the data."""


def write_page(recordings: Sequence[Recording], out: Path) -> None:
    """Write one HTML file that plays a flight, with a second one as its ghost; written completely or not at all.

    Raises
    ------
    Refused
        If the page is not built, or if `out` is not an `.html` file in an existing folder.
    """
    check_out(out, ".html")
    if not TEMPLATE.is_file():
        raise Refused(f"there is no `{TEMPLATE.name}` beside `{Path(__file__).name}`; `make lab` builds it (with npm)")
    table = {
        "looks": [look_table(recording.look) for recording in recordings],
        "flights": [flight_table(recording) for recording in recordings],
    }
    # Within a script, `<` may begin its end or a comment.
    words = json.dumps(table, allow_nan=False).replace("<", "\\u003c")
    page = TEMPLATE.read_text(encoding="utf-8").replace(PLACE, words, 1)
    with complete_file(out) as draft:
        draft.write_text(page, encoding="utf-8")


def look_table(look: Look) -> dict[str, Any]:
    """Return shapes, jets, links, colours and scales as plain tables."""
    names = ("FORCE", "WIND", "REFERENCE", "TRAIL", "PLUME", "GHOST", "FELL", "COMPLETED")
    scales = drawing.Scales()
    return {
        "version": rust.__version__,
        "shapes": [_shape(shape) for shape in look.shapes],
        "jets": [_mount(mount) for mount in look.jets],
        "links": [_mount(mount) for mount in look.links],
        "colours": {name.lower(): getattr(drawing, name) for name in names} | dict(drawing.ROLES),
        "scales": {"force": scales.force, "thrust": scales.thrust, "wind": scales.wind},
        "plume_radius": drawing.PLUME_RADIUS,
        "overhead": drawing.OVERHEAD,
    }


def flight_table(recording: Recording) -> dict[str, Any]:
    """Return a flight's signals and the poses of its bodies at `RATE` samples per second, in single precision."""
    times = recording.signals["time"]
    step = max(round(1.0 / RATE / (times[1] - times[0])), 1) if times.size > 1 else 1
    shown = np.arange(0, times.size, step)
    instants = [recording.at(time) for time in times[shown]]
    columns = [np.swapaxes(now.body_rotations, 1, 2)[:, :2].reshape(-1, 6) for now in instants]
    poses = np.concatenate([columns, [now.body_positions for now in instants]], axis=2)
    declared = rust.signals()
    # Raw measurements are those of other signals, but for errors of sensors and missing values.
    names = [name for name in recording.signals if not name.startswith("raw_")]
    numbers = {name: recording.signals[name][shown] for name in names}
    return {
        "title": recording.title,
        "verdict": recording.verdict,
        "outcome": recording.outcome,
        "lost_time": recording.lost_time,
        "timeStep": float(times[step] - times[0]) if times.size > step else 1.0,
        "rows": int(shown.size),
        "jets": list(recording.robot.jet_names),
        "links": list(recording.robot.aero_link_names),
        "bodies": len(recording.robot.body_names),
        "signals": [
            {"name": name, "unit": declared[name].unit, "width": recording.rows(name).shape[1]} for name in names
        ],
        "numbers": {name: _pack(signal) for name, signal in (numbers | {"body_poses": poses}).items()},
    }


def _pack(numbers: Any) -> str:
    return base64.b64encode(np.asarray(numbers, dtype="<f4").tobytes()).decode()


def _shape(shape: Shape) -> dict[str, Any]:
    pose = shape.body_from_shape
    table: dict[str, Any] = {
        "kind": shape.kind,
        "size": shape.size,
        "role": shape.role,
        "body": shape.body,
        "rotation": _round_numbers(pose.rotation.T),  # by columns
        "position": _round_numbers(pose.position),
    }
    if shape.mesh is not None:
        faces = base64.b64encode(shape.mesh.faces.astype("<u4").tobytes()).decode()
        table |= {"vertices": _pack(shape.mesh.vertices * shape.size), "faces": faces}
    return table


def _mount(mount: Mount) -> dict[str, Any]:
    return {
        "name": mount.name,
        "body": mount.body,
        "position": _round_numbers(mount.position),
        "axis": _round_numbers(mount.axis),
    }


def _round_numbers(numbers: Any) -> list[float]:
    return [round(float(number), 6) for number in numbers.ravel()]
